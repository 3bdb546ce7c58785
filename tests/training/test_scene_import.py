"""Trajectory files as scenes for the trainer."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from anchorflow_training.batches import FlowBatchConfig, draw_batch
from anchorflow_training.data import DatasetError, SyntheticTrajectoryDataset, TrajectoryDataset
from anchorflow_training.data.scene_import import (
    ImportConfig,
    SceneOptions,
    import_scenes,
)
from anchorflow_training.dataset import DTYPES, SceneDataset, open_dataset
from anchorflow_trajectory.cost.clearance import clearance_field
from anchorflow_trajectory.routes.search import MOST_ROUTES

STEPS = 21
RADIUS = 0.2


def straight_lines(y: list[float], *, dim: int = 2) -> np.ndarray:
    """Trajectories from (1, y) to (5, y) at 2 m/s, [N, T, D]."""
    lines = np.zeros((len(y), STEPS, dim))
    lines[..., 0] = np.linspace(1.0, 5.0, STEPS)
    lines[..., 1] = np.array(y)[:, None]
    return lines


def l2_file(path: Path, y: list[float], **more: Any) -> Path:
    """6 x 4 m with a wall of cells at 2.8 <= x <= 3.2, y <= 1."""
    maps = np.zeros((len(y), 1, 40, 60), np.float32)
    maps[:, 0, :10, 28:32] = 1.0
    arrays: dict[str, Any] = {"positions": straight_lines(y), "horizon_s": 2.0, "cost_maps": maps}
    arrays |= {"resolution": 0.1, "origin": np.zeros(2)}
    np.savez(path, **(arrays | more))
    return path


def imported(path: Path, out: Path, **options: Any) -> SceneDataset:
    config = ImportConfig(scene=SceneOptions(robot_radius=RADIUS, cells=32), **options)
    import_scenes(TrajectoryDataset(path), out, config)
    return open_dataset(out)


def test_pictures_are_no_condition(tmp_path: Path) -> None:
    path = l2_file(tmp_path / "l2.npz", [3.0], scene_images=np.zeros((1, 3, 8, 8), np.uint8))
    with pytest.raises(DatasetError, match=r"l2\.npz: scene_images: expected no pictures, which"):
        imported(path, tmp_path / "out")


def test_a_sample_becomes_a_scene(tmp_path: Path) -> None:
    styles = np.array([[2.0, 1.0, 1.0], [0.0, 0.0, 5.0]])
    path = l2_file(tmp_path / "l2.npz", [3.0, 2.0], style_weights=styles)
    scenes = imported(path, tmp_path / "out")
    rows = scenes.batch(np.arange(2))
    assert {name: array.dtype for name, array in scenes.arrays.items()} == DTYPES
    np.testing.assert_allclose(rows["x_curr"][0], [1, 3, 2, 0, 0, 0], atol=1e-5)
    np.testing.assert_allclose(rows["x_goal"][1], [5, 2, 2, 0], atol=1e-5)
    np.testing.assert_allclose(rows["w_style"], [[0.8, 0.1, 0.1], [0, 0, 1]], rtol=1e-6)
    np.testing.assert_allclose(rows["map_geometry"], [[0, 0, 0.1]] * 2, rtol=1e-6)
    occupied, traversability, risk = rows["cost_map"][0]
    np.testing.assert_array_equal(traversability, 1)
    np.testing.assert_array_equal(risk, 0)
    clearance = clearance_field(occupied >= 0.5, 0.1, RADIUS)
    np.testing.assert_allclose(rows["clearance"][0], clearance, atol=2e-3)
    np.testing.assert_allclose(rows["limits"], [[2.1, 1e-3, RADIUS, 2.0]] * 2, rtol=1e-6)
    np.testing.assert_allclose(rows["durations"], 2.0)
    assert rows["route_states"].shape == (2, MOST_ROUTES, STEPS, 7)
    np.testing.assert_allclose(np.exp(rows["route_states"][:, 0, :, -1]), 2.0, rtol=1e-6)
    assert rows["states"].shape == (2, 1, STEPS, 6)
    np.testing.assert_allclose(rows["states"][0, 0, :, 2], 2.0, atol=1e-6)


def test_the_folder_tells_the_trainer_what_it_needs(tmp_path: Path) -> None:
    scenes = imported(l2_file(tmp_path / "l2.npz", [3.0, 2.0]), tmp_path / "out")
    assert (scenes.num_steps, scenes.dim, scenes.map_channels) == (STEPS, 2, 3)
    assert scenes.limits.horizon_s == pytest.approx(2.0)
    assert scenes.limits.v_max == pytest.approx(2.1)
    assert scenes.meta["statistics"]["positions"]["mean"] == pytest.approx([3.0, 2.5])
    assert scenes.meta["families"] == {"l2": 2}
    batch = draw_batch(scenes, FlowBatchConfig(scenes=2, samples=4), 0)
    assert batch["states"].shape == (2, 4, STEPS, 7)
    assert "starts" not in batch  # noise is paired with the data instead


def test_a_sample_follows_the_route_that_it_lies_nearest_to(tmp_path: Path) -> None:
    """A block in the middle: the sample below it and the one above go different ways round."""
    maps = np.zeros((2, 1, 40, 60), np.float32)
    maps[:, 0, 16:24, 24:36] = 1.0
    positions = straight_lines([2.0, 2.0])
    positions[..., 1] += np.outer([-1.2, 1.2], np.sin(np.linspace(0, np.pi, STEPS)))
    path = l2_file(tmp_path / "l2.npz", [2.0, 2.0], positions=positions, cost_maps=maps)
    rows = imported(path, tmp_path / "out").batch(np.arange(2))
    for height, routes, route in zip((-1, 1), rows["route_states"], rows["route"], strict=True):
        chosen = routes[int(route[0])]
        assert (chosen[STEPS // 2, 1] - 2.0) * height > 0.3
    assert set(rows["route"][:, 0]) == {0, 1}


@pytest.mark.parametrize("said", ["dt", "horizon_s"])
def test_samples_may_have_durations_of_their_own(said: str, tmp_path: Path) -> None:
    """Half of the scenes fix their durations, the others do not."""
    lasting = np.array([2.0, 2.5, 4.0, 2.0])
    told = lasting / (STEPS - 1) if said == "dt" else lasting
    positions = straight_lines([3.0, 2.0, 2.5, 2.8])
    arrays: dict[str, Any] = {"positions": positions, said: told}
    np.savez(tmp_path / "p.npz", **arrays)
    scenes = imported(tmp_path / "p.npz", tmp_path / "out")
    rows = scenes.batch(np.arange(4))
    np.testing.assert_allclose(rows["durations"][:, 0], lasting, rtol=1e-6)
    np.testing.assert_allclose(rows["limits"][:, 3], [0, 2.5, 0, 2.0], rtol=1e-6)
    np.testing.assert_allclose(rows["x_curr"][:, 2], 4.0 / lasting, rtol=1e-5)
    np.testing.assert_allclose(rows["states"][:, 0, 5, 2], 4.0 / lasting, rtol=1e-5)
    assert scenes.limits.horizon_s is None
    assert scenes.meta["ranges"] == {"horizon_s": pytest.approx([2.0, 4.0])}
    one = imported(l2_file(tmp_path / "l2.npz", [3.0], horizon_s=[2.0]), tmp_path / "one")
    assert one.limits.horizon_s == pytest.approx(2.0)
    assert one.meta["ranges"] == {}


def test_limits_are_the_data_s_or_the_caller_s(tmp_path: Path) -> None:
    path = l2_file(tmp_path / "l2.npz", [3.0, 2.0])
    scenes = imported(path, tmp_path / "out", v_max=1.5, a_max=4.0)
    assert (scenes.limits.v_max, scenes.limits.a_max) == (1.5, 4.0)
    assert scenes.meta["over_limits"] == 2


def test_samples_that_do_not_fit_their_map_are_left_out(tmp_path: Path) -> None:
    heights = [3.0, 0.5, 1.1, 9.0, 2.0, 2.5]
    positions = straight_lines(heights)
    positions[4, 7] = np.nan
    path = l2_file(
        tmp_path / "l2.npz",
        heights,
        positions=positions,
        quality=np.array([1, 1, 1, 1, 1, 0.2]),
    )
    scenes = imported(path, tmp_path / "out", least_quality=0.5)
    assert scenes.meta["left_out"] == {
        "not_finite": 1,
        "missed_ends": 0,
        "off_map": 1,
        "collision": 2,
        "low_quality": 1,
    }
    assert scenes.meta["not_finite_rows"] == [4]
    assert len(scenes) == 1
    np.testing.assert_allclose(scenes.arrays["x_curr"][0, 1], 3.0, rtol=1e-6)
    kept = ImportConfig(scene=SceneOptions(RADIUS, keep_collisions=True))
    meta = import_scenes(TrajectoryDataset(path), tmp_path / "kept", kept)
    assert (meta["scenes"], meta["left_out"]["collision"]) == (4, 0)


def test_the_maps_edge_is_on_the_map(tmp_path: Path) -> None:
    """As on the wire: the upper edge belongs to the last cell."""
    positions = straight_lines([3.0])
    positions[..., 0] = np.linspace(1.0, 6.0, STEPS)
    path = l2_file(tmp_path / "l2.npz", [3.0], positions=positions)
    kept = ImportConfig(scene=SceneOptions(RADIUS, keep_collisions=True))
    meta = import_scenes(TrajectoryDataset(path), tmp_path / "out", kept)
    assert (meta["scenes"], meta["left_out"]["off_map"]) == (1, 0)


def test_a_margin_must_be_kept(tmp_path: Path) -> None:
    """The line at y = 1.5 passes 0.5 m from the wall, 0.3 m beyond the robot's radius."""
    path = l2_file(tmp_path / "l2.npz", [1.5, 1.5], safety_margins=np.array([0.2, 0.4]))
    scenes = imported(path, tmp_path / "out")
    assert scenes.meta["left_out"]["collision"] == 1
    assert len(scenes) == 1


def test_given_ends_are_taken(tmp_path: Path) -> None:
    start, goal = np.array([[1, 3, 1, 0.5, 0, 0.1]]), np.array([[5, 3, 0, 0]])
    path = l2_file(tmp_path / "l2.npz", [3.0], start_states=start, goal_states=goal)
    scenes = imported(path, tmp_path / "out")
    np.testing.assert_allclose(scenes.arrays["x_curr"], start, rtol=1e-6)
    np.testing.assert_allclose(scenes.arrays["x_goal"], goal)


def test_samples_that_miss_a_given_end_are_left_out(tmp_path: Path) -> None:
    goal = np.array([[5, 3, 0, 0], [5, 2.91, 0, 0], [5, 2.89, 0, 0], [1, 3, 0, 0]])
    path = l2_file(tmp_path / "goal.npz", [3.0] * 4, goal_states=goal)
    scenes = imported(path, tmp_path / "goal")
    assert scenes.meta["left_out"]["missed_ends"] == 2
    np.testing.assert_allclose(scenes.arrays["x_goal"], goal[:2], rtol=1e-6)
    start = np.array([[1, 3, 2, 0, 0, 0], [1.2, 3, 2, 0, 0, 0]])
    path = l2_file(tmp_path / "start.npz", [3.0] * 2, start_states=start)
    assert imported(path, tmp_path / "start").meta["left_out"]["missed_ends"] == 1


def test_a_heading_that_is_given_for_an_end_runs_on_as_those_between(tmp_path: Path) -> None:
    positions = straight_lines([3.0], dim=3)
    heading = np.linspace(3.0, 3.6, STEPS)
    positions[0, :, 2] = (heading + np.pi) % (2 * np.pi) - np.pi
    goal = np.concatenate([positions[:, -1], np.zeros((1, 3))], -1)
    np.savez(tmp_path / "h.npz", positions=positions, dt=0.1, goal_states=goal)
    scenes = imported(tmp_path / "h.npz", tmp_path / "out")
    np.testing.assert_allclose(scenes.arrays["x_goal"][0, 2], 3.6, atol=1e-5)


@pytest.mark.parametrize("dim", [2, 3])
def test_samples_without_a_map_get_an_empty_one(dim: int, tmp_path: Path) -> None:
    positions = straight_lines([0.0, 1.0], dim=dim)
    positions[..., :2] += [4.5e5, 5.3e6]  # a map projection's metres
    np.savez(tmp_path / "p.npz", positions=positions, dt=0.1)
    scenes = imported(tmp_path / "p.npz", tmp_path / "out")
    assert scenes.dim == dim
    rows = scenes.batch(np.arange(2))
    *origin, resolution = rows["map_geometry"][0]
    np.testing.assert_allclose(origin, -16 * resolution, rtol=1e-6)
    np.testing.assert_array_equal(rows["cost_map"][:, 0], 0)
    path = rows["states"][0, 0, :, :2]
    np.testing.assert_allclose(path[[0, -1]], [[-2, 0], [2, 0]], atol=1e-6)
    assert (np.abs(path) < 16 * resolution - 2).all()
    np.testing.assert_allclose(np.diff(path[:, 0]), 0.2, atol=1e-6)
    assert rows["x_curr"].shape == (2, 3 * dim)
    assert rows["x_goal"].shape == (2, 2 * dim)


def test_workers_write_the_same_bytes(tmp_path: Path) -> None:
    path = l2_file(tmp_path / "l2.npz", [3.0, 0.5, 2.0, 2.5])
    for workers in (1, 2):
        import_scenes(TrajectoryDataset(path), tmp_path / str(workers), workers=workers)
    for file in (tmp_path / "1").iterdir():
        assert file.read_bytes() == (tmp_path / "2" / file.name).read_bytes()


def test_a_subclass_is_what_scenes_are_made_of(tmp_path: Path) -> None:
    class Raised(TrajectoryDataset):
        """Every trajectory is half a metre higher than in the file."""

        def __getitem__(self, index: int) -> dict[str, torch.Tensor]:
            sample = super().__getitem__(index)
            return sample | {"positions": sample["positions"] + torch.tensor([0.0, 0.5])}

    path = l2_file(tmp_path / "l2.npz", [2.0, 2.5])
    meta = import_scenes(Raised(path), tmp_path / "out")
    states = open_dataset(tmp_path / "out").arrays["states"]
    np.testing.assert_allclose(states[:, 0, 0, 1], [2.5, 3.0], rtol=1e-6)
    assert meta["statistics"]["positions"]["mean"] == pytest.approx([3.0, 2.75])


@pytest.mark.parametrize("key", ["quality", "trajectory_quality"])
def test_a_sample_s_quality_stands_beside_its_scene(key: str, tmp_path: Path) -> None:
    path = l2_file(tmp_path / "l2.npz", [3.0, 2.0], **{key: np.array([0.25, 1.0])})
    scenes = imported(path, tmp_path / "out")
    np.testing.assert_array_equal(scenes.arrays["quality"], [[0.25], [1.0]])
    plain = imported(l2_file(tmp_path / "b.npz", [3.0]), tmp_path / "out")
    assert "quality" not in plain.arrays  # an earlier dataset's is not left lying there


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"v_max": -1.0}, r"v_max: expected a finite number above 0, got -1"),
        ({"a_max": float("nan")}, r"a_max: .*got nan"),
        ({"least_quality": 2.0}, r"least_quality: expected 0 to 1, got 2"),
        ({"least_quality": 0.5}, r"p\.npz: quality: expected an array \[N\]"),
    ],
)
def test_options_out_of_their_range_are_named(
    options: dict[str, float], said: str, tmp_path: Path
) -> None:
    path = l2_file(tmp_path / "p.npz", [3.0])
    with pytest.raises(DatasetError, match=said):
        imported(path, tmp_path / "out", **options)


def test_a_quality_of_nothing_and_a_folder_that_is_a_file_are_refused(tmp_path: Path) -> None:
    path = l2_file(tmp_path / "l2.npz", [3.0, 2.0], quality=np.zeros(2))
    with pytest.raises(DatasetError, match=r"l2\.npz: quality: expected more than 0.*2 samples"):
        imported(path, tmp_path / "out")
    with pytest.raises(DatasetError, match=r"l2\.npz: expected a folder to write to"):
        imported(path, path)


def test_a_full_disk_for_what_a_dataset_tells_is_named(tmp_path: Path) -> None:
    (tmp_path / f"dataset.json.{os.getpid()}").symlink_to("/dev/full")
    with pytest.raises(DatasetError, match=r"dataset\.json: expected a place to write .*No space"):
        import_scenes(SyntheticTrajectoryDataset("sine", 2, num_steps=16), tmp_path)
    assert not [*tmp_path.glob("dataset.json*")]


def test_what_the_file_does_not_say_is_asked_for(tmp_path: Path) -> None:
    lines = straight_lines([3.0])
    np.savez(tmp_path / "a.npz", positions=lines, velocities=lines, accelerations=lines)
    with pytest.raises(DatasetError, match=r"a\.npz: horizon_s: .*--horizon-s"):
        import_scenes(TrajectoryDataset(tmp_path / "a.npz"), tmp_path / "out")
    maps = np.zeros((1, 1, 40, 60))
    np.savez(tmp_path / "b.npz", positions=lines, dt=0.1, cost_maps=maps)
    with pytest.raises(DatasetError, match=r"b\.npz: resolution: .*--resolution"):
        import_scenes(TrajectoryDataset(tmp_path / "b.npz"), tmp_path / "out")
    dataset = TrajectoryDataset(tmp_path / "b.npz", resolution=0.02)
    with pytest.raises(DatasetError, match=r"b\.npz: no sample is left.*'off_map': 1"):
        import_scenes(dataset, tmp_path / "out")


def test_samples_that_all_stand_still_are_refused(tmp_path: Path) -> None:
    still = np.ones((2, STEPS, 2))
    np.savez(tmp_path / "still.npz", positions=still, dt=0.1)
    with pytest.raises(DatasetError, match=r"still\.npz: positions: expected a sample that moves"):
        imported(tmp_path / "still.npz", tmp_path / "out")
    assert not (tmp_path / "out").exists()
