"""Make a dataset: draw scenes, let the expert solve them, keep what it solved.

Scene i depends on the seed and on i alone, so the bytes do not depend on the number of workers.
"""

from __future__ import annotations

import multiprocessing
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from anchorflow_training.dataset import Row, create_arrays, scene_row, write_meta
from anchorflow_training.expert import ExpertConfig, chosen_by_route, solve
from anchorflow_training.scenes import RobotRanges, SceneError, draw_scene
from anchorflow_trajectory.cost.trajectory_cost import CostWeights
from anchorflow_trajectory.motion import MotionLimits


@dataclass(frozen=True)
class DataConfig:
    """What `make_dataset` draws.

    scenes: S; trajectories: M kept a scene; cells: H = W of the maps
    least: a scene with fewer good trajectories is redrawn
    without_choice: share of the draws with one route or none that are left out
    limits: of the robot that is drawn most; robots: of the others
    """

    scenes: int
    seed: int = 0
    trajectories: int = 24
    least: int = 3
    cells: int = 96
    without_choice: float = 0.5
    limits: MotionLimits = field(default_factory=lambda: MotionLimits(v_max=2.0, a_max=3.0))
    robots: RobotRanges = field(default_factory=RobotRanges)
    expert: ExpertConfig = field(default_factory=ExpertConfig)


@dataclass(frozen=True)
class SceneRecord:
    """One solved scene, and how many draws and tries it took."""

    row: Row
    family: str
    unsolved: tuple[str, ...]
    good_share: float


@contextmanager
def mapper(workers: int) -> Iterator[Callable[..., Any]]:
    """Yield `map` over that many processes, in the order of the tasks; of one, `map` itself."""
    if workers == 1:
        yield map
        return
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        yield partial(pool.imap, chunksize=8)


def make_dataset(
    path: Path,
    config: DataConfig,
    *,
    workers: int,
    progress: Callable[[int], None] = lambda _: None,
) -> dict[str, Any]:
    """Write the dataset folder, return its `dataset.json`; `progress` gets 1 a finished scene.

    Raises `DatasetError` if the folder cannot be written.
    """
    arrays, families, unsolved, shares = None, Counter(), Counter(), []
    tasks = ((config, i) for i in range(config.scenes))
    with mapper(workers) as mapped:
        for index, record in enumerate(mapped(_solved_scene, tasks)):
            if arrays is None:
                shapes = {n: (config.scenes, *a.shape) for n, a in record.row.items()}
                arrays = create_arrays(path, shapes)
            for name, value in record.row.items():
                arrays[name][index] = value
            families[record.family] += 1
            unsolved.update(record.unsolved)
            shares.append(record.good_share)
            progress(1)
    meta = {
        "format": 1,
        "scenes": config.scenes,
        "trajectories": config.trajectories,
        "num_steps": config.expert.num_samples,
        "dim": 2,
        "limits": asdict(config.limits),
        "ranges": asdict(config.robots),
        "map": {"H": config.cells, "W": config.cells, "channels": 3},
        "config": asdict(config) | {"weights": asdict(CostWeights())},
        "families": dict(sorted(families.items())),
        "unsolved": dict(sorted(unsolved.items())),
        "good_share": round(float(np.mean(shares)), 4),
    }
    write_meta(path, meta)
    return meta


def _solved_scene(task: tuple[DataConfig, int]) -> SceneRecord:
    """The first draw for this index that the expert solves often enough."""
    config, index = task
    rng = np.random.default_rng([config.seed, index])
    unsolved: list[str] = []
    while True:
        try:
            scene = draw_scene(rng, cells=config.cells, limits=config.limits, robots=config.robots)
        except SceneError:
            continue
        if len(scene.routes) < 2 and rng.random() < config.without_choice:
            continue
        solution = solve(scene, config=config.expert, rng=rng)
        good = np.flatnonzero(solution.good)
        if len(good) >= config.least:
            break
        unsolved.append(scene.family)
    chosen = chosen_by_route(solution, config.trajectories, rng=rng)
    splines = solution.splines[chosen]
    states = np.concatenate(scene.basis.states(splines), axis=-1)
    began = solution.began
    row = scene_row(scene, states, durations=splines.duration, route=began.route[chosen])
    row["starts"] = began.disturbance[chosen]
    return SceneRecord(row, scene.family, tuple(unsolved), len(good) / len(solution.good))
