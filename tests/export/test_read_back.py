"""A bundle's graphs give back the weights of the network that it was exported from."""

from __future__ import annotations

import json
import shutil
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from command_line import failure, succeed
from exported_bundles import export_as_traced, export_once
from small_v2x import small_sizes

from anchorflow_client.contract import SamplerChoice, resolve_for_card
from anchorflow_export.adapter import ExportChoices
from anchorflow_export.parity import graph_differences
from anchorflow_export.planners import adapter_of, choices_of
from anchorflow_export.quantization import rounded_graphs
from anchorflow_export.read_back import read_weights
from anchorflow_models.registry import planner_named
from anchorflow_models.torch_graphs import TorchGraphs
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_service.engine import Engine
from anchorflow_training.checkpoint import load_checkpoint, restore_model, weights_before
from anchorflow_training.config import TrainerConfig

CHECKPOINTS = Path(__file__).parents[2] / "checkpoints"
CHECKPOINT = CHECKPOINTS / "goalflow.pt"
SHIPPED = DEFAULT_BUNDLE.parent
# By planner: parts that only training uses, and those that are read to within a rounding.
CASES = {
    "wote": (
        ("occupancy", "future_"),
        ("to_anchor.", "anchor_", "backbone."),
    ),
    "v2x_vlm": (("decoder.", "projection", "locator", "position_embed"), ()),
}


@pytest.mark.parametrize("planner", CASES)
def test_every_weight_of_a_graph_is_read(planner: str) -> None:
    made = export_once(planner)
    unused, rounded = CASES[planner]
    with small_sizes():
        model = planner_named(planner).create(made.network.config).eval()
        if planner == "v2x_vlm":
            model.tokenizer = made.network.tokenizer
        read = read_weights(load_bundle(made.path), model, ExportChoices(), planner=planner)
    assert all(any(part in name for name in read.anew) for part in unused), read.anew
    assert max(each.error for each in read.differences) < 1e-4
    wanted = made.network.state_dict()
    same = [name for name in wanted if not any(part in name for part in (*unused, *rounded))]
    assert len(same) > 0.3 * len(wanted)
    for name in same:
        torch.testing.assert_close(read.weights[name], wanted[name], rtol=0, atol=0, msg=name)


def test_a_bundle_says_how_it_was_exported(tmp_path: Path) -> None:
    student, goalflow = (load_bundle(SHIPPED / n) for n in ("student", "goalflow"))
    assert choices_of(student) == {
        "sampler": SamplerChoice("euler", (0.0, 1.0)),
        "noise_scale": 1.0,
        "robot_radius": 0.25,
        "safety_margin": 0.1,
        "refine_steps": 6,
        "refine_rate": 0.12,
    }
    uniform = SamplerChoice("euler", (0.0, 1.0))
    wanted = {"sampler": uniform, "noise_scale": 1.0, "score": {}, "goal_inputs": False}
    assert choices_of(goalflow) == wanted
    said = failure("export", CHECKPOINT, "--like", student.path, "--out", tmp_path / "other")
    assert "expected a bundle of goalflow, got one of flowmp" in said


@pytest.mark.parametrize("name", ["default", "student"])
def test_a_checkpoint_has_the_weights_of_the_bundle_in_eight_bits(name: str) -> None:
    saved, bundle = load_checkpoint(CHECKPOINTS / f"{name}.pt"), load_bundle(SHIPPED / name)
    assert saved.config == bundle.manifest.training["config"]
    assert saved.step == bundle.manifest.training["steps"]
    choices = ExportChoices(**choices_of(bundle))
    adapter = adapter_of("flowmp", restore_model(saved), choices)
    whole = [each for each in graph_differences(adapter, bundle) if each.what.startswith("modul")]
    assert whole
    assert max(each.error for each in whole) < 1e-5
    request = resolve_for_card(
        replace(adapter.request(bundle.card, {**adapter.sample_sizes, "B": 4}, 0), seed=0),
        bundle.card,
    )
    engines = (
        Engine(bundle, threads=1),
        Engine(bundle, threads=1, graphs=TorchGraphs(adapter.roles)),
    )
    rounded, exact = (
        np.stack([each.states[..., :2] for each in engine.samples(request)]) for engine in engines
    )
    apart = np.sqrt(((rounded - exact) ** 2).sum(-1).mean())
    assert 0.001 < apart < 0.05  # m, of which rounding is


def test_a_checkpoint_of_a_bundle_in_eight_bits(
    flowmp_rounded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It begins a run, its weights are the network's but for the rounding, and a bundle like the
    rounded one may be in float32."""
    made, rounded, file = export_once("flowmp"), tmp_path / "rounded", tmp_path / "made.pt"
    shutil.copytree(flowmp_rounded, rounded)
    assert "training.config.model" in failure("checkpoint", rounded, "--out", file)
    manifest = json.loads((rounded / "manifest.json").read_text())
    manifest["training"] = {"steps": 7, "config": {"model": asdict(made.network.config)}}
    (rounded / "manifest.json").write_text(json.dumps(manifest))
    succeed("checkpoint", rounded, "--out", file)
    assert load_checkpoint(file).step == 7
    got = weights_before(str(file), TrainerConfig(model=made.network.config))
    for name, wanted in made.network.state_dict().items():
        apart = (got[name] - wanted).abs().max() / wanted.abs().max().clamp(min=1e-3)
        assert apart < 0.02, name
    like = ("--like", str(rounded), "--float32")
    assert "expected int8 or float32, got both" in failure(
        "export", file, *like, "--int8", "--out", tmp_path / "both"
    )
    whole = export_as_traced(made, file, tmp_path / "whole", *like, monkeypatch=monkeypatch)
    assert rounded_graphs(load_bundle(rounded)).keys() == {"encode", "field"}
    assert not rounded_graphs(load_bundle(whole))
