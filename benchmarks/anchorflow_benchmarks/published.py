"""Train a published configuration for a step, export it and ask it, with weights drawn at random.

It says nothing of quality: no published weights are part of this. Run by `anchorflow bench
published`.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Annotated

import typer

from anchorflow_benchmarks import options
from anchorflow_benchmarks.checkpoints import drives, output_of, pairs, run
from anchorflow_benchmarks.report import ResultTable, Row, report
from anchorflow_client.contract import resolve_for_card
from anchorflow_export.adapter import ExportChoices
from anchorflow_export.planners import adapter_of
from anchorflow_service.bundle import DEFAULT_BUNDLE, Bundle, load_bundle
from anchorflow_service.engine import Engine
from anchorflow_training.checkpoint import Checkpoint, load_checkpoint, restore_model
from anchorflow_training.v2x.text import opened, train_tokenizer

EXAMPLES = DEFAULT_BUNDLE.parents[3] / "examples"
REQUESTS = 3
WORDS, PIXELS = 51_289, 768  # of Florence-2
DIFFERENCE = re.compile(r": (\d\.\d+e[+-]\d+|nan)$", re.MULTILINE)


@dataclass(frozen=True)
class Published:
    """A configuration file of driving logs or of pairs, and what its commands take besides."""

    file: str
    of_pairs: bool = False
    train: tuple[object, ...] = ("--batch.scenes", 2, "--held-out", 0)
    export: tuple[object, ...] = ()


ONE_PAIR = ("--batch.scenes", 1, "--epochs", 0, "--evaluation.scenes", 1)
PUBLISHED: Mapping[str, Published] = {
    "wote": Published("wote"),
    "diffusiondrive": Published("diffusiondrive"),
    "goalflow": Published("goalflow", export=("--schedule", 5)),
    "v2x-vlm": Published("v2x-vlm", True, ONE_PAIR),
    "v2x-vlm-large": Published("v2x-vlm", True, (*ONE_PAIR, "--variant", "large")),
}
NOTE = (
    "step s: of the command that trains one step, preparing its data; parity: the largest "
    "difference from torch, by the export's proof; MB: of all graphs; request ms: the median of "
    f"{REQUESTS} random requests, the first one left out."
)


def published(
    names: Annotated[
        list[str] | None,
        typer.Argument(help=f"Of {', '.join(PUBLISHED)}.", show_default="all but large"),
    ] = None,
    *,
    threads: Annotated[int, typer.Option(min=1, help="Of a request.")] = 1,
    out: options.Out = options.RESULTS,
) -> None:
    """Train the published configurations a step, export them and time their requests."""
    chosen = names or [name for name in PUBLISHED if not name.endswith("large")]
    if unknown := [name for name in chosen if name not in PUBLISHED]:
        raise typer.BadParameter(f"expected names of {', '.join(PUBLISHED)}, got {unknown[0]}")
    about = {"configurations": ", ".join(chosen), "threads of a request": str(threads)}
    rows: list[Row] = []
    for name in chosen:
        with tempfile.TemporaryDirectory() as scratch:
            rows.append(measured(name, Path(scratch, name), threads))
        # Written each time: the next may take a quarter of an hour.
        report("Published", about, [ResultTable("Published configurations", rows, NOTE)], out)


def measured(name: str, folder: Path, threads: int) -> Row:
    """Return the row of a configuration. Raises `BenchmarkError` if a command fails."""
    told, saved = PUBLISHED[name], folder / "run" / "checkpoint.pt"
    folder.mkdir()
    data = folder / "data"
    if told.of_pairs:
        pairs(data, PIXELS, tokenizer(folder))
    else:
        drives(data)
    once = ("--steps", 1, "--warmup", 0, "--no-tensorboard", *told.train)
    config = EXAMPLES / f"{told.file}-published.yaml"
    trained = run("train", data, "--config", config, "--out", saved.parent, *once)
    proof, exported = output_of("export", saved, *told.export, "--out", folder / "bundle")
    checkpoint, bundle = load_checkpoint(saved, in_file=True), load_bundle(folder / "bundle")
    graphs, model = bundle.manifest.graphs, restore_model(checkpoint)
    return {
        "configuration": name,
        "weights, millions": sum(each.numel() for each in model.parameters()) / 1e6,
        "step s": trained,
        "export s": exported,
        "parity": f"{max(map(float, DIFFERENCE.findall(proof))):.1e}",
        "MB": sum(bundle.graph_path(role).stat().st_size for role in graphs) / 1e6,
        "request ms": 1e3 * seconds_of_a_request(bundle, checkpoint, threads),
    }


def tokenizer(folder: Path) -> Path:
    """Write a tokenizer of as many words as Florence-2's, most of them never used."""
    made = opened(train_tokenizer(["The ego vehicle drives."]))
    made.add_tokens([f"<{number}>" for number in range(WORDS - made.get_vocab_size())])
    file = folder / "tokenizer.json"
    made.save(str(file))
    return file


def seconds_of_a_request(bundle: Bundle, checkpoint: Checkpoint, threads: int) -> float:
    """Return the median of random requests, whose anchors are as many as the card's default."""
    adapter = adapter_of(checkpoint.planner, restore_model(checkpoint), ExportChoices())
    engine, sizes, spent = Engine(bundle, threads=threads), {**adapter.sample_sizes, "B": 1}, []
    for seed in range(1 + REQUESTS):
        request = replace(adapter.request(bundle.card, sizes, seed), seed=seed)
        resolved, began = resolve_for_card(request, bundle.card), perf_counter()
        engine.plan(resolved)
        spent.append(perf_counter() - began)
    return median(spent[1:])
