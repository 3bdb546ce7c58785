"""Scenes read from a file and scenes drawn."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from anchorflow_benchmarks import BenchmarkError
from anchorflow_benchmarks.scene_files import (
    ONE_ROBOT,
    WITHOUT_FILE,
    default_source,
    draw_scenes,
    load_scenes,
    read_scenes,
)
from anchorflow_training.scenes import draw_scene
from anchorflow_trajectory.motion import MotionLimits


@pytest.fixture
def scene_file(tmp_path: Path) -> Callable[..., Path]:
    """Writes a file of three scenes in the shared format; fields can be changed or left out."""

    def write(**changes: object) -> Path:
        occupied = np.zeros((3, 16, 16), bool)
        occupied[0, 2, 5] = True  # row 2 from the bottom, column 5
        fields: dict[str, object] = {
            "occupancy": np.packbits(occupied, axis=-1),
            "resolution": np.float32(0.5),
            "x_curr": np.tile(np.array([-3, 0, 1, 0, 0, 0], np.float32), (3, 1)),
            "x_goal": np.tile(np.array([3, 0, 0, 0], np.float32), (3, 1)),
            "robot_radius": np.float32(0.25),
            "family": np.array(["barn", "city/Berlin_0", "city/Berlin_1"]),
        }
        arrays = {name: value for name, value in (fields | changes).items() if value is not None}
        path = tmp_path / "scenes.npz"
        np.savez(path, **arrays)  # pyright: ignore[reportArgumentType]
        return path

    return write


def test_a_file_is_read_as_it_was_written(
    scene_file: Callable[..., Path], limits: MotionLimits
) -> None:
    first, second, third = read_scenes(scene_file(), limits=limits)

    assert [s.family for s in (first, second, third)] == ["barn", "city", "city"]
    assert np.argwhere(first.occupied).tolist() == [[2, 5]]
    assert first.origin.tolist() == [-4.0, -4.0]
    assert (first.resolution, first.robot_radius) == (0.5, 0.25)
    # The cell's centre is at (-1.25, -2.75): the robot's disc is a quarter cell inside its edge.
    assert first.clearance_field[2, 6] == pytest.approx(0.0)
    assert not second.occupied.any()
    assert second.x_curr[2] == 1.0
    assert first.motion == limits


def test_a_limit_keeps_scenes_evenly_spread(
    scene_file: Callable[..., Path], limits: MotionLimits
) -> None:
    path = str(scene_file(family=np.array(["a", "b", "c"])))

    assert [s.family for s in load_scenes(path, limits=limits, limit=2)] == ["a", "c"]
    assert len(load_scenes(path, limits=limits, limit=5)) == 3


@pytest.mark.parametrize("missing", ["occupancy", "x_goal", "robot_radius"])
def test_a_file_that_lacks_a_key_is_named(
    missing: str, scene_file: Callable[..., Path], limits: MotionLimits
) -> None:
    path = scene_file(**{missing: None})
    with pytest.raises(
        BenchmarkError, match=rf"not a file of scenes \(expected the key '{missing}'"
    ):
        read_scenes(path, limits=limits)


def test_a_file_that_is_none_is_named(tmp_path: Path, limits: MotionLimits) -> None:
    path = tmp_path / "text.npz"
    path.write_text("no scenes")
    np.save(tmp_path / "array.npy", np.zeros(3))
    for broken in (path, tmp_path / "array.npy", tmp_path / "missing.npz"):
        with pytest.raises(BenchmarkError, match=broken.name):
            read_scenes(broken, limits=limits)


def test_drawn_scenes_depend_on_the_seed_and_are_not_those_of_a_dataset(
    limits: MotionLimits,
) -> None:
    first, again = (draw_scenes(2, 7, limits=limits, cells=48) for _ in range(2))
    trained = draw_scene(np.random.default_rng([7, 0]), cells=48, limits=limits, robots=ONE_ROBOT)

    np.testing.assert_array_equal(again[1].x_goal, first[1].x_goal)
    np.testing.assert_array_equal(again[1].occupied, first[1].occupied)
    assert not np.array_equal(first[0].x_curr, trained.x_curr)
    assert not np.array_equal(first[0].x_curr, first[1].x_curr)
    assert {scene.motion for scene in first} == {limits}  # one robot, and no horizon
    assert len(load_scenes("drawn:2:7", limits=limits)) == 2


def test_without_the_file_scenes_are_drawn(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, scene_file: Callable[..., Path]
) -> None:
    monkeypatch.setenv("ANCHORFLOW_SHARED_DATA", str(tmp_path))
    assert default_source() == WITHOUT_FILE

    scene_file().rename(tmp_path / "scenes_public.npz")
    assert default_source() == str(tmp_path / "scenes_public.npz")
