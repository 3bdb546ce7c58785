"""Train on from bundles: read their weights back, take a step, export, and compare the answers.

Each bundle is exported twice with the choices of its own manifest: from its checkpoint, unchanged,
and after one training step on a little data that is made here. The checkpoint is that in
`checkpoints/`, or else the one that `anchorflow checkpoint` reads back. Run by `anchorflow bench
checkpoints`.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_benchmarks import BenchmarkError, options
from anchorflow_benchmarks.programs import CLI
from anchorflow_benchmarks.report import ResultTable, Row, report, say
from anchorflow_client.contract import VisionLanguageSpec, resolve_for_card
from anchorflow_export.adapter import ExportChoices
from anchorflow_export.planners import adapter_of
from anchorflow_service.bundle import DEFAULT_BUNDLE, Bundle, load_bundle
from anchorflow_service.engine import Engine
from anchorflow_training.checkpoint import load_checkpoint, restore_model

Trajectories = NDArray[np.float32]

SAVED = DEFAULT_BUNDLE.parents[3] / "checkpoints"
SHIPPED = ("default", "student", "goalflow", "wote", "diffusiondrive", "v2x")
REQUESTS, ANCHORS = 4, 16
OPTIONS = {"goalflow": ("--objective.stage", "outcomes")}
"""What training needs besides: GoalFlow's scorer is what was trained last."""
NOTE = (
    f"Distances in m between trajectories of the bundle and of its copy, each with the nearest, "
    f"over {REQUESTS} random requests. same: graphs with equal bytes, of all. Seconds of each "
    "command; without read s, the checkpoint is in checkpoints/."
)


def checkpoints(*, bundles: options.Bundles = None, out: options.Out = options.RESULTS) -> None:
    """Train on from bundles: their weights read back, a step, an export, the answers compared."""
    folders = bundles or [DEFAULT_BUNDLE.parent / name for name in SHIPPED]
    with tempfile.TemporaryDirectory() as scratch:
        rows = [trained_on(load_bundle(each), Path(scratch, each.name)) for each in folders]
    names = ", ".join(each.name for each in folders)
    report("Checkpoints", {"bundles": names}, [ResultTable("Trained on", rows, NOTE)], out)


def trained_on(bundle: Bundle, folder: Path) -> Row:
    """Return the row of a bundle. Raises `BenchmarkError` if a command fails."""
    planner, saved = bundle.manifest.planner, folder / "read.pt"
    like = ("--like", bundle.path)
    seconds: dict[str, float | None] = {"read s": None}
    if (shipped := SAVED / f"{bundle.path.name}.pt").exists():
        saved = shipped
    else:
        seconds["read s"] = run("checkpoint", bundle.path, "--out", saved)
    seconds["export s"] = run("export", saved, *like, "--out", folder / "unchanged")
    data = _data(bundle, folder / "data")
    words = ("--steps", 1, "--batch.scenes", 2, "--no-tensorboard", *OPTIONS.get(planner, ()))
    seconds["step s"] = run(
        *("train", data, "--planner", planner, "--before", saved, "--out", folder / "run"), *words
    )
    run("export", folder / "run/checkpoint.pt", *like, "--out", folder / "stepped")
    row: dict[str, Any] = {"bundle": bundle.path.name, "checkpoint MB": saved.stat().st_size / 1e6}
    wanted = answers(bundle, saved)
    for name in ("unchanged", "stepped"):
        copy = load_bundle(folder / name)
        apart = distances(answers(copy, saved), wanted)
        row |= {f"{name}, mean": float(apart.mean()), f"{name}, max": float(apart.max())}
        if name == "unchanged":
            own, others = bundle.manifest.graphs, copy.manifest.graphs
            same = sum(own[role].sha256 == others[role].sha256 for role in others)
            row["same"] = f"{same} of {len(others)}"
    return row | seconds


def run(*words: object) -> float:
    """Run a command and return its seconds. Raises `BenchmarkError` if it fails."""
    return output_of(*words)[1]


def output_of(*words: object) -> tuple[str, float]:
    """Run a command; return what it prints, and its seconds. Raises as `run`."""
    told, started = [*map(str, words)], perf_counter()
    say(f"anchorflow {' '.join(told)}")
    program = [sys.executable, "-c", CLI, *told]
    answer = subprocess.run(program, check=False, capture_output=True, text=True)
    if answer.returncode:
        raise BenchmarkError(f"anchorflow {' '.join(told)}: {answer.stderr.strip()[-500:]}")
    return answer.stdout, perf_counter() - started


def _data(bundle: Bundle, folder: Path) -> Path:
    """Write a little data for a bundle's planner; return its folder."""
    conditioning = bundle.card.conditioning
    if bundle.manifest.planner == "flowmp":
        run("data", "make", folder, "--scenes", 4)
        return folder
    if isinstance(conditioning, VisionLanguageSpec):
        return pairs(folder, conditioning.image_size, bundle.file_path("tokenizer"))
    return drives(folder)


def drives(folder: Path) -> Path:
    """Write a little simulated driving; return its folder."""
    run("data", "drive", "--out", folder, "--logs", 1, "--windows", 4, "--workers", 1)
    return folder


def pairs(folder: Path, image_size: int, tokenizer: Path) -> Path:
    """Write a few pairs of pictures; return their folder."""
    recording = folder.with_name("recording")
    run("data", "crossings", recording, "--scenes", 4)
    words = ("--image-size", image_size, "--tokenizer", tokenizer)
    run("data", "pairs", recording, folder, *words)
    return folder


def answers(bundle: Bundle, checkpoint: Path) -> Sequence[Trajectories]:
    """Return the trajectories [N,T,D] of every random request, the same for a bundle's copies."""
    saved = load_checkpoint(checkpoint)
    adapter = adapter_of(saved.planner, restore_model(saved), ExportChoices())
    engine, sizes = Engine(bundle, threads=1), {**adapter.sample_sizes, "B": 1}
    planned = []
    for seed in range(REQUESTS):
        request = replace(adapter.request(bundle.card, sizes, seed), seed=seed)
        if adapter.num_samples is not None:
            request = replace(request, num_samples=ANCHORS)
        answer = engine.plan(resolve_for_card(request, bundle.card)).trajectories
        planned.append(answer.reshape(-1, *answer.shape[-2:]))
    return planned


def distances(got: Sequence[Trajectories], wanted: Sequence[Trajectories]) -> NDArray[np.float64]:
    """Return the largest distance of poses [m] between each trajectory and the nearest wanted."""
    apart = [
        np.linalg.norm(one[:, None, :, :2] - other[None, :, :, :2], axis=-1).max(-1).min(1)
        for one, other in zip(got, wanted, strict=True)
    ]
    return np.concatenate(apart)
