"""A small network of each planner, and its bundle, which is exported once for all tests.

An export takes up to a minute, most of it in torch; see `export_once`.
"""

from __future__ import annotations

import hashlib
import json
import platform
import shutil
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from fcntl import LOCK_EX, flock
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import onnx
import pytest
import tiny_wote
import torch
from command_line import succeed
from flowmp_scenes import open_branches
from small_v2x import small_sizes, small_v2x
from tiny_diffusiondrive import TINY, tiny_diffusiondrive
from torch import nn

from anchorflow_client.contract import EIGHT_STEP_SCHEDULE, SamplerChoice
from anchorflow_export.adapter import ExportChoices, PlannerAdapter
from anchorflow_export.bundle import BundleDescription, export_bundle
from anchorflow_export.futures import add_futures
from anchorflow_export.parity import Difference
from anchorflow_export.planners import adapter_of
from anchorflow_export.tracing import TracedGraph
from anchorflow_models import L2Config, create_l2_safety_cfm
from anchorflow_models.futures import FuturesConfig, FuturesNetwork
from anchorflow_models.goalflow import BevLayout, GoalFlowConfig, create_goalflow, ways
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_training.checkpoint import load_checkpoint, save_checkpoint
from anchorflow_trajectory.motion import MotionLimits

ROOT = Path(__file__).parents[2]
SOURCES = ("client", "trajectory", "models", "training", "service", "export", "tests/planners")
# Every option of the small preset that the published planner lacks but `driven`, whose rollout is
# half of a graph's operations: WoTE's bundle proves it.
DIFFUSION = replace(
    TINY,
    backbone=replace(TINY.backbone, lidar_before=True),
    encounters=TINY.footprint,
    ground_sight=True,
    direction=True,
    imitation=0.1,
    pessimistic=True,
)
# A trace unrolls loops over steps, over picked goals and those of UNROLLED: few turns are enough.
# It looks at features of one's own; tests/export/test_goalflow.py proves what a drawn raster has.
GOALFLOW = GoalFlowConfig(
    num_steps=2,
    bev=BevLayout(64, 40, 27, (-4.0, 36.0, -13.5, 13.5), "float32"),
    goals=16,
    picked=3,
    width=16,
    channels=8,
    feature_channels=4,
    layers=1,
    outcomes=True,
)
# The same on sensors; the raster that they are to show is small, too.
SENSING = replace(
    GOALFLOW,
    bev=BevLayout(rows=32, columns=16, extent=(-8.0, 24.0, -8.0, 8.0)),
    outcomes=False,
    sensors=True,
    ground_sight=True,
    transfuser=DIFFUSION.backbone,
)
# Of two sweeps of the LiDAR; its rollout is unrolled too.
WOTE = replace(
    tiny_wote.TINY,
    num_steps=2,
    kept=5,
    driven=True,
    backbone=replace(tiny_wote.TINY.backbone, lidar_before=True),
)
CHOICES = {
    "flowmp": ExportChoices(
        limits=MotionLimits(1.5, 2.5),
        ranges={"v_max": (0.2, 4.0), "a_max": (0.3, 6.0), "horizon_s": (1.0, 60.0)},
        robot_radius=0.3,
        sampler=SamplerChoice("rk4", EIGHT_STEP_SCHEDULE),
    ),
    "goalflow": ExportChoices(goal_inputs=True),
}
PREDICTING = "goalflow-futures"
UNROLLED: dict[str, Any] = {"LEADINGS": 2, "STRETCHES": 1}
"""Turns of GoalFlow's own loops while it is exported and compared."""


def untaught(**options: Any) -> nn.Module:
    """A flow with the same weights every time; branches that start at zero would prove little."""
    with torch.random.fork_rng():
        torch.manual_seed(0)
        model = create_l2_safety_cfm(L2Config(map_size=16, layers=1, **options)).eval()
        open_branches(model, std=0.02)
    model.prior.set_covariance(0.04 * np.eye(model.prior.rank))
    return model


def small_goalflow(config: GoalFlowConfig = GOALFLOW) -> nn.Module:
    """A GoalFlow whose scores are the rules' and, of features, the learnt outcomes'."""
    with torch.random.fork_rng():
        torch.manual_seed(0)
        model = create_goalflow(config).eval()
        with torch.no_grad():
            for parameter in model.parameters():
                parameter.add_(0.05 * torch.randn(parameter.shape))
    return model


NETWORKS: dict[str, Callable[[], Any]] = {
    "flowmp": lambda: untaught(num_steps=24, num_control_points=12),
    "flowmp-unet": lambda: untaught(
        backbone="unet", num_steps=45, map_attention=True, map_lookup=False, map_scales=2
    ),
    "goalflow": small_goalflow,
    "goalflow-sensors": lambda: small_goalflow(SENSING),
    "wote": lambda: tiny_wote.tiny_wote(WOTE),
    "diffusiondrive": lambda: tiny_diffusiondrive(DIFFUSION),
    "v2x_vlm": lambda: small_v2x(pooled_columns=2),
}


@dataclass(frozen=True)
class Exported:
    """A small network and its bundle; to read, not to change."""

    network: Any
    path: Path
    differences: tuple[Difference, ...]


def small_futures() -> FuturesNetwork:
    """A small network that predicts the others for the GoalFlow that ships."""
    with torch.random.fork_rng():
        torch.manual_seed(0)
        return FuturesNetwork(FuturesConfig(width=16, map_channels=4))


def export_once(network: str) -> Exported:
    """Export a small network, PLANNER or PLANNER-OPTION, as `small-NETWORK`; as PREDICTING, put a
    small network that predicts the others into the GoalFlow that ships.

    All workers share the export, and wait for one another. It is kept in .pytest_cache until the
    code that it comes from changes.
    """
    return _exported(network, ROOT / ".pytest_cache" / "exported" / _digest())


def export_as_traced(
    made: Exported, checkpoint: Path, out: Path, *options: str, monkeypatch: pytest.MonkeyPatch
) -> Path:
    """Export a checkpoint by the command, with weights and graphs of a small network's bundle.

    To trace graphs anew takes a minute.
    """
    saved, weights = load_checkpoint(checkpoint), made.network.state_dict()
    config = {**saved.config, "model": asdict(made.network.config)}
    save_checkpoint(checkpoint, replace(saved, config=config, model=weights, average=weights))
    bundle = load_bundle(made.path)
    traced = {
        role: TracedGraph(onnx.load(bundle.graph_path(role)), graph.inputs, graph.outputs)
        for role, graph in bundle.manifest.graphs.items()
    }
    monkeypatch.setattr(PlannerAdapter, "trace", lambda _, role, _earlier: traced[role])
    with patch.multiple(ways, **UNROLLED):
        succeed("export", checkpoint, *options, "--out", out)
    return out


@cache
def _digest() -> str:
    """Return a hash of all code and libraries that decide on an export."""
    hashed = hashlib.sha256(f"{sys.version}, {platform.platform()}".encode())
    for library in ("torch", "transformers", "tokenizers", "onnx", "onnxscript", "onnxruntime"):
        hashed.update(f"{library} {version(library)}".encode())
    for folder in SOURCES:
        for file in sorted((ROOT / folder).rglob("*.py")):
            hashed.update(f"{file.relative_to(ROOT)}".encode() + file.read_bytes())
    return hashed.hexdigest()[:16]


@cache
def _exported(network: str, folder: Path) -> Exported:
    out = folder / network / "bundle"
    folder.mkdir(parents=True, exist_ok=True)
    for other in folder.parent.iterdir():
        if other != folder:  # of code that has changed
            shutil.rmtree(other, ignore_errors=True)
    with small_sizes(), (folder / f"{network}.json").open("a+") as record:
        made = small_futures() if network == PREDICTING else NETWORKS[network]()
        flock(record, LOCK_EX)
        record.seek(0)
        if not (text := record.read()):
            text = json.dumps([*map(asdict, _export(network, made, out))])
            record.write(text)
    return Exported(made, out, tuple(Difference(**each) for each in json.loads(text)))


def _export(network: str, made: Any, out: Path) -> tuple[Difference, ...]:
    if network == PREDICTING:
        shutil.copytree(DEFAULT_BUNDLE.parent / "goalflow", out)
        return add_futures(made, out, training={"steps": 3}, version="9.0.0")
    planner, name = network.partition("-")[0], f"small-{network.replace('_', '-')}"
    adapter = adapter_of(planner, made, CHOICES.get(network, ExportChoices()))
    description = BundleDescription(name=name, version="1.0.0", planner=planner)
    with patch.multiple(ways, **UNROLLED):
        return export_bundle(adapter, description, out=out)
