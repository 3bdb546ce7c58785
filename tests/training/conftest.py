"""A dataset that needs no expert: smooth random trajectories round one block on small maps."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from anchorflow_training.dataset import SceneDataset, create_arrays, open_dataset
from anchorflow_trajectory.clearance import clearance_field
from anchorflow_trajectory.spline import spline_basis

CELLS, RESOLUTION, HORIZON_S = 32, 0.25, 8.0
SCENES, TRAJECTORIES, STEPS = 6, 4, 64
LIMITS = {"v_max": 2.0, "a_max": 3.0, "horizon_s": HORIZON_S}


def write_tiny_dataset(path: Path) -> Path:
    """Always the same bytes: six scenes, each a block of its own place between start and goal."""
    rng = np.random.default_rng(7)
    rows = [_scene(rng) for _ in range(SCENES)]
    shapes = {name: (SCENES, *value.shape) for name, value in rows[0].items()}
    arrays = create_arrays(path, shapes)
    for name, array in arrays.items():
        array[:] = np.stack([row[name] for row in rows])
    meta = {"format": 1, "scenes": SCENES, "config": {"limits": LIMITS}}
    (path / "dataset.json").write_text(json.dumps(meta))
    return path


def _scene(rng: np.random.Generator) -> dict[str, np.ndarray]:
    half = CELLS * RESOLUTION / 2
    row, column = rng.integers(8, 20, 2)
    cost_map = np.zeros((3, CELLS, CELLS), np.uint8)
    cost_map[0, row : row + 4, column : column + 4] = 255
    cost_map[1] = 255
    x_curr = np.array([-3.0, *rng.uniform(-1, 1, 1), 0.5, 0.0, 0.0, 0.0], np.float32)
    x_goal = np.array([3.0, *rng.uniform(-1, 1, 1), 0.0, 0.0], np.float32)
    basis = spline_basis(STEPS, HORIZON_S)
    control = np.repeat(basis.rest_curve(x_curr, x_goal)[:, None], TRAJECTORIES, axis=1)
    control[..., basis.free] += rng.normal(0, 0.3, control[..., basis.free].shape)
    line = (np.arange(CELLS) + 0.5) * RESOLUTION - half
    ends = x_curr[:2], x_goal[:2]
    return {
        "cost_map": cost_map,
        "clearance": clearance_field(cost_map[0] > 127, RESOLUTION, 0.25).astype(np.float16),
        "cost_to_go": np.array(
            [np.hypot(line - x, line[:, None] - y) for x, y in ends], np.float16
        ),
        "map_geometry": np.array([-half, -half, RESOLUTION], np.float32),
        "x_curr": x_curr,
        "x_goal": x_goal,
        "w_style": np.array([0.4, 0.3, 0.3], np.float32),
        "states": np.concatenate(basis.states(control), axis=-1),
    }


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
