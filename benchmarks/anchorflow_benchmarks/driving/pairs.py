"""V2X-VLM's bundles on pairs that they have not seen: L2 and collisions, beside constant velocity.

On drawn crossings it is known who is hidden from the car, so those are counted apart: there the
roadside picture alone shows who comes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_benchmarks.report import ResultTable, Row
from anchorflow_driving.cooperative.crossings import draw_crossing
from anchorflow_driving.cooperative.layout import CooperativeFrame, write_recording
from anchorflow_service.local import LocalClient
from anchorflow_training.v2x.dataset import PairDataset, make_pairs
from anchorflow_training.v2x.evaluation import HORIZONS_S, baselines, judge
from anchorflow_training.v2x.prompts import UNTOLD

UNSEEN = 90_000
"""The first seed of the crossings that are judged; `anchorflow data crossings` is far from it."""
NOTE = (
    "L2 to the recorded way, m; collision: share of plans whose box overlaps the box of another at "
    "that frame, up to that time. driven: the record itself. ms: median of a request."
)


@dataclass(frozen=True, eq=False)
class Group:
    """title: of a table; indices: the pairs of a dataset that it counts"""

    title: str
    indices: NDArray[np.int64]


def judged_crossings(folder: Path, *, scenes: int, image_size: int) -> tuple[PairDataset, list]:
    """Unseen crossings as pairs in an empty folder, and their groups: all, and those hidden."""
    drawn = [draw_crossing(UNSEEN + number) for number in range(scenes)]
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


def pair_tables(
    clients: Mapping[str, LocalClient],
    dataset: PairDataset,
    groups: Sequence[Group],
    *,
    progress: Callable[[int], object] = lambda _: None,
) -> list[ResultTable]:
    """A table a group: baselines, and each bundle with everything, without the roadside picture,
    and without text.

    clients: of bundles, by what the tables call them
    """
    everything = np.unique(np.concatenate([group.indices for group in groups]))
    plans: dict[str, NDArray[np.float64]] = {**baselines(dataset, everything)}
    times: dict[str, float] = {}
    asked = [("", True, True), (" without roadside", False, True), (" without text", True, False)]
    for name, client, roadside, text in (
        (name + how, client, *told) for name, client in clients.items() for how, *told in asked
    ):
        ways, spent = [], []
        for index in everything:
            inputs = _inputs(dataset, int(index), roadside=roadside, text=text)
            began = perf_counter()
            ways.append(client.plan(inputs=inputs).trajectories[0, :, :2])
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
