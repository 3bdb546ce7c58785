"""A dataset that needs no expert: smooth random trajectories round one block on small maps."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from anchorflow_training.dataset import Row, SceneDataset, create_arrays, open_dataset, scene_row
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.routes.splines import STRETCH, spread_round
from anchorflow_trajectory.scene import Scene

CELLS, RESOLUTION, HORIZON_S = 32, 0.25, 8.0
SCENES, TRAJECTORIES = 6, 4
LIMITS = MotionLimits(v_max=2.0, a_max=3.0)
RANGES = {"v_max": [1.0, 3.0], "horizon_s": [4.0, 20.0]}


def write_tiny_dataset(path: Path) -> Path:
    """Always the same bytes: six scenes, each a block of its own place between start and goal.

    The last of each three has a horizon, the others leave durations open.
    """
    rng = np.random.default_rng(7)
    rows = [_scene(rng, HORIZON_S if i % 3 == 2 else None) for i in range(SCENES)]
    shapes = {name: (SCENES, *value.shape) for name, value in rows[0].items()}
    arrays = create_arrays(path, shapes)
    for name, array in arrays.items():
        array[:] = np.stack([row[name] for row in rows])
    meta = {"format": 1, "scenes": SCENES, "limits": asdict(LIMITS), "ranges": RANGES}
    (path / "dataset.json").write_text(json.dumps(meta))
    return path


def _scene(rng: np.random.Generator, horizon_s: float | None) -> Row:
    row, column = rng.integers(8, 20, 2)
    cost_map = np.zeros((3, CELLS, CELLS), np.float32)
    cost_map[0, row : row + 4, column : column + 4] = 1.0
    cost_map[1] = 1.0
    scene = Scene(
        cost_map=cost_map,
        resolution=RESOLUTION,
        origin=np.full(2, -CELLS * RESOLUTION / 2),
        robot_radius=0.25,
        x_curr=np.array([-3.0, *rng.uniform(-1, 1, 1), 0.5, 0.0, 0.0, 0.0], np.float32),
        x_goal=np.array([3.0, *rng.uniform(-1, 1, 1), 0.0, 0.0], np.float32),
        w_style=np.array([0.4, 0.3, 0.3]),
        motion=MotionLimits(LIMITS.v_max, LIMITS.a_max, horizon_s),
    )
    stretch = 0.0 if horizon_s else STRETCH
    tried = spread_round(
        scene.route_splines,
        scene.basis,
        tries=TRAJECTORIES,
        rng=rng,
        spread=0.3,
        stretch=stretch,
    )
    states = np.concatenate(scene.basis.states(tried.splines), axis=-1)
    return scene_row(scene, states, durations=tried.splines.duration, route=tried.route)


@pytest.fixture(scope="session")
def tiny_dataset_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_tiny_dataset(tmp_path_factory.mktemp("tiny"))


@pytest.fixture
def tiny_dataset(tiny_dataset_path: Path) -> SceneDataset:
    return open_dataset(tiny_dataset_path)


@pytest.fixture(scope="session")
def write_dataset() -> Callable[[Path], Path]:
    """Writes the tiny dataset to a folder of the test's own."""
    return write_tiny_dataset
