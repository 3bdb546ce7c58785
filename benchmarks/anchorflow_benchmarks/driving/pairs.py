"""Judge V2X-VLM bundles and checkpoints on unseen pairs of pictures: L2 and collisions.

Drawn crossings know who is hidden from the car. Those pairs get a table of their own, because only
the roadside picture shows who comes. Run by `anchorflow bench pairs`.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Annotated, Any

import numpy as np
import torch
import typer
from numpy.typing import NDArray

from anchorflow_benchmarks import options
from anchorflow_benchmarks.report import ResultTable, Row, progress, record, report
from anchorflow_client.contract import VisionLanguageSpec
from anchorflow_driving.cooperative.crossings import draw_crossing
from anchorflow_driving.cooperative.layout import CooperativeFrame, write_recording
from anchorflow_service.local import LocalClient
from anchorflow_training.checkpoint import load_checkpoint, restore_model
from anchorflow_training.v2x.dataset import PairDataset, make_pairs, open_pairs
from anchorflow_training.v2x.evaluation import HORIZONS_S, baselines, judge
from anchorflow_training.v2x.run import V2XRunConfig
from anchorflow_training.v2x.text import UNTOLD, opened, token_rows

UNSEEN_SEED = 90_000  # of the first crossing; `anchorflow data crossings` stays far below
NOTE = (
    "L2 to the recorded way, m; collision: share of plans whose box overlaps the box of another at "
    "that frame, up to that time. driven: the record itself. ms: median of a request."
)


@dataclass(frozen=True, eq=False)
class Group:
    """title: of a table; indices: its pairs of a dataset"""

    title: str
    indices: NDArray[np.int64]


def judged_crossings(folder: Path, *, scenes: int, image_size: int) -> tuple[PairDataset, list]:
    """Write unseen crossings as pairs to an empty folder; return all pairs and the hidden ones."""
    drawn = [draw_crossing(UNSEEN_SEED + number) for number in range(scenes)]
    names = [f"{number:06d}" for number in range(scenes)]
    drives: list[tuple[str, list[CooperativeFrame]]] = [
        (name, crossing.frames) for name, crossing in zip(names, drawn, strict=True)
    ]
    write_recording(folder / "recording", drives)
    dataset = make_pairs(folder / "recording", folder / "pairs", image_size=image_size)
    frames = len(drawn[0].frames)
    rows = np.asarray(dataset.arrays["frame"])
    hidden = np.array(
        [
            drawn[row // frames].conflict and bool(drawn[row // frames].occluded[row % frames])
            for row in rows
        ]
    )
    everything = np.arange(len(dataset))
    return dataset, [Group("All pairs", everything), Group("Hidden", everything[hidden])]


Inputs = Mapping[str, Any]
Planner = Callable[[Inputs], NDArray[np.floating]]
"""Plans waypoints [45, 2] m."""


def planner_of_bundle(client: LocalClient) -> Planner:
    return lambda inputs: client.plan(inputs=inputs).trajectories[0, :, :2]


@torch.no_grad()
def planned(model: Any, inputs: Inputs) -> NDArray[np.floating]:
    """Return the waypoints [45, 2] m of a V2X-VLM in torch."""
    seen = model.look(torch.from_numpy(inputs["vehicle_image"])[None])
    beside = torch.zeros_like(seen)
    if has_roadside := "infrastructure_image" in inputs:
        beside = model.look(torch.from_numpy(inputs["infrastructure_image"])[None])
    tokens, _ = token_rows(
        opened(model.tokenizer), [inputs["prompt"]], most=model.config.max_tokens
    )
    fused = model.fuse(seen, beside, torch.tensor([has_roadside]), torch.from_numpy(tokens))
    return model.drive(fused)[0].numpy()


def pair_tables(
    planners: Mapping[str, Planner],
    dataset: PairDataset,
    groups: Sequence[Group],
    *,
    progress: Callable[[int], object] = lambda _: None,
) -> list[ResultTable]:
    """Return a table per group: baselines, and each planner with all inputs, without the roadside
    picture, and without text.

    planners: by their names in the tables
    """
    everything = np.unique(np.concatenate([group.indices for group in groups]))
    plans: dict[str, NDArray[np.float64]] = {**baselines(dataset, everything)}
    times: dict[str, float] = {}
    asked = [("", True, True), (" without roadside", False, True), (" without text", True, False)]
    for name, plan, roadside, text in (
        (name + how, plan, *told) for name, plan in planners.items() for how, *told in asked
    ):
        ways, spent = [], []
        for index in everything:
            inputs = _inputs(dataset, int(index), roadside=roadside, text=text)
            began = perf_counter()
            ways.append(plan(inputs))
            spent.append(1e3 * (perf_counter() - began))
            progress(1)
        plans[name], times[name] = np.array(ways, float), median(spent)
    tables = []
    for group in groups:
        chosen = np.isin(everything, group.indices)
        rows = [
            _row(name, judge(dataset, everything[chosen], each[chosen]), times.get(name))
            for name, each in plans.items()
            if chosen.any()
        ]
        note = NOTE if not tables else ""
        tables.append(ResultTable(f"{group.title} ({int(chosen.sum())})", rows, note))
    return tables


def _inputs(dataset: PairDataset, index: int, *, roadside: bool, text: bool) -> dict[str, Any]:
    names = ("vehicle_image", *(("infrastructure_image",) if roadside else ()))
    inputs: dict[str, Any] = {name: np.array(dataset.arrays[name][index]) for name in names}
    return inputs | {"prompt": dataset.prompts[index] if text else UNTOLD}


def _row(name: str, figures: dict[str, float], ms: float | None) -> Row:
    row: dict[str, Any] = {"plan": name}
    for what, key in (("L2", "l2"), ("collision", "collision")):
        row |= {f"{what} {each} s": figures[f"{key}_{each}s"] for each in HORIZONS_S}
        row[f"{what} mean"] = figures[f"{key}_mean"]
    return {**row, "ms": ms}


@dataclass(frozen=True)
class Judged:
    """A bundle, or a checkpoint in torch; name: in the tables; image_size: pixels along a side."""

    name: str
    image_size: int
    plan: Planner


def judged_planner(path: Path, threads: int | None) -> Judged:
    """Open a bundle's folder or a checkpoint's file. Raises `AnchorFlowError`."""
    if path.is_dir():
        client = LocalClient.of(path, threads=threads)
        return Judged(client.engine.card.name, _image_size(client), planner_of_bundle(client))
    saved, name = load_checkpoint(path), f"{path.parent.name}/{path.name}"
    if saved.planner != V2XRunConfig.planner:
        expected = f"expected a {V2XRunConfig.planner}, got one of {saved.planner}"
        raise typer.BadParameter(f"{path}: {expected}")
    model = restore_model(saved)
    return Judged(name, model.config.image_size, partial(planned, model))


def pairs(
    bundles: Annotated[
        list[Path], typer.Argument(help="Folders of V2X-VLM bundles, or files of checkpoints.")
    ],
    *,
    data: Annotated[
        Path | None,
        typer.Option(help="Folder of pairs; those held out are judged.", show_default="drawn"),
    ] = None,
    crossings: Annotated[int, typer.Option(min=2, help="Scenes drawn, without --data.")] = 200,
    threads: options.Threads = None,
    recorded: options.Record = False,
    out: options.Out = options.RESULTS,
) -> None:
    """Judge V2X-VLM bundles and checkpoints by L2 and collisions, with and without the roadside
    picture."""
    judged = [judged_planner(path, threads) for path in bundles]
    sizes = {each.name: each.image_size for each in judged}
    if len({*sizes.values()}) > 1:
        raise typer.BadParameter(f"expected bundles asked with pictures of one size, got {sizes}")
    planners = {each.name: each.plan for each in judged}
    if len(planners) < len(bundles):
        raise typer.BadParameter(f"expected bundles of different names, got {', '.join(planners)}")
    if recorded and not all(path.is_dir() for path in bundles):
        raise typer.BadParameter("expected bundles alone with --record, got a checkpoint")
    with tempfile.TemporaryDirectory() as scratch:
        if data is None:
            (size,) = {*sizes.values()}
            dataset, groups = judged_crossings(Path(scratch), scenes=crossings, image_size=size)
        else:
            dataset = open_pairs(data)
            groups = [Group("Held out", dataset.indices(held_out=True))]
        with progress("pairs", 3 * len(planners) * len(groups[0].indices)) as advance:
            tables = pair_tables(planners, dataset, groups, progress=advance)
    of = data.name if data else f"{crossings} drawn crossings"
    report("Pairs", {"bundles": ", ".join(planners), "pairs": of}, tables, out)
    if recorded:
        record(zip(planners, bundles, strict=True), {"pairs": of}, tables[0])


def _image_size(client: LocalClient) -> int:
    card = client.engine.card
    if not isinstance(card.conditioning, VisionLanguageSpec):
        kind = card.conditioning.kind
        raise typer.BadParameter(f"{card.name}: expected a bundle asked with pictures, got {kind}")
    return card.conditioning.image_size
