"""The expert's data: solved, several ways round, the same bytes from any number of workers."""

from pathlib import Path

import numpy as np
import pytest

from anchorflow_training.batches import BatchConfig, draw_batch, mirror
from anchorflow_training.dataset import DTYPES, DatasetError, SceneDataset, open_dataset
from anchorflow_training.expert import ExpertConfig, solve
from anchorflow_training.make_data import DataConfig, make_dataset
from anchorflow_trajectory.clearance import GridField, path_clearance
from anchorflow_trajectory.cost import MotionLimits
from anchorflow_trajectory.scene import Scene
from anchorflow_trajectory.verify import verify

LIMITS = MotionLimits(v_max=2.0, a_max=3.0, horizon_s=8.0)
CONFIG = DataConfig(scenes=6, seed=3, trajectories=8)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> SceneDataset:
    path = tmp_path_factory.mktemp("data")
    make_dataset(path, CONFIG, workers=2)
    return open_dataset(path)


def test_any_number_of_workers_writes_the_same_bytes(dataset: SceneDataset, tmp_path: Path) -> None:
    make_dataset(tmp_path, CONFIG, workers=1)
    for name in DTYPES:
        assert (tmp_path / f"{name}.npy").read_bytes() == (
            dataset.path / f"{name}.npy"
        ).read_bytes()


def test_kept_trajectories_are_good(dataset: SceneDataset) -> None:
    scenes = dataset.batch(np.arange(len(dataset)))
    for index, states in enumerate(scenes["states"]):
        origin, resolution = np.split(scenes["map_geometry"][index], [2])
        field = GridField(scenes["clearance"][index], float(resolution[0]), origin)
        position, velocity, acceleration = np.split(states, 3, axis=-1)
        verdict = verify((position, velocity, acceleration), field, LIMITS)
        assert verdict.clearance.min() > 0
        assert verdict.feasible.all()
        x_curr, x_goal = scenes["x_curr"][index], scenes["x_goal"][index]
        np.testing.assert_allclose(states[:, 0], np.tile(x_curr, (8, 1)), atol=2e-4)
        np.testing.assert_allclose(states[:, -1, :4], np.tile(x_goal, (8, 1)), atol=2e-5)


def test_the_expert_passes_a_post_on_both_sides() -> None:
    occupied = np.zeros((96, 96), bool)
    occupied[42:54, 42:54] = True
    cost_map = np.stack([occupied, np.ones_like(occupied), np.zeros_like(occupied)]).astype(
        np.float32
    )
    scene = Scene(
        cost_map=cost_map,
        resolution=0.1,
        origin=np.zeros(2),
        robot_radius=0.25,
        x_curr=np.asarray([1.0, 4.8, 0, 0, 0, 0], np.float32),
        x_goal=np.asarray([8.6, 4.8, 0, 0], np.float32),
        w_style=np.asarray([0.4, 0.3, 0.3], np.float32),
    )
    solution = solve(scene, config=ExpertConfig(), limits=LIMITS, rng=np.random.default_rng(0))
    middle = solution.control[1, solution.good, 9]
    assert solution.good.mean() > 0.7
    assert (middle > 5.4).any()
    assert (middle < 4.2).any()


def test_batches_hold_each_trajectory_equally_often(dataset: SceneDataset) -> None:
    batch = draw_batch(dataset, BatchConfig(scenes=3, samples=16), 0)
    assert batch["states"].shape == (3, 16, 64, 6)
    again = draw_batch(dataset, BatchConfig(scenes=3, samples=16), 0)
    np.testing.assert_array_equal(batch["states"], again["states"])
    other = draw_batch(dataset, BatchConfig(scenes=3, samples=16), 1)
    assert not np.array_equal(batch["states"], other["states"])


def test_a_mirrored_scene_is_the_same_problem(dataset: SceneDataset) -> None:
    batch = dataset.batch(np.arange(2))
    mirrored = {k: v.copy() for k, v in batch.items()}
    mirror(mirrored)
    for scenes in (batch, mirrored):
        *origin, resolution = scenes["map_geometry"][0]
        field = GridField(scenes["clearance"][0], float(resolution), np.array(origin))
        scenes["found"] = path_clearance(field, scenes["states"][0], max_step=0.05)
    np.testing.assert_allclose(batch["found"], mirrored["found"], atol=1e-5)
    mirror(mirrored)
    np.testing.assert_allclose(mirrored["states"], batch["states"])
    np.testing.assert_allclose(mirrored["map_geometry"], batch["map_geometry"], atol=1e-5)


def test_a_broken_dataset_names_its_file(dataset: SceneDataset, tmp_path: Path) -> None:
    for file in dataset.path.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    np.save(tmp_path / "x_goal.npy", np.zeros((2, 4)))
    with pytest.raises(DatasetError, match=r"x_goal\.npy.*float32 \[6, \.\.\.\].*float64 \[2, 4\]"):
        open_dataset(tmp_path)
    (tmp_path / "dataset.json").unlink()
    with pytest.raises(DatasetError, match=r"dataset\.json"):
        open_dataset(tmp_path)
