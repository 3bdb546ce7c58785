"""Recorded poses: KITTI and DAIR-V2X files become ego-centred trajectories."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from anchorflow_training.data import DatasetError, TrajectoryDataset
from anchorflow_training.data.poses import CutConfig, PoseTrack, cut_trajectories, read_poses

RADIUS, SPEED, DT = 20.0, 5.0, 0.1


def circle(count: int = 60, start: float = 0.7) -> np.ndarray:
    """Poses [P, 3] on a left-hand circle, beginning at heading `start`."""
    heading = start + np.arange(count) * DT * SPEED / RADIUS
    x, y = RADIUS * np.sin(heading), -RADIUS * np.cos(heading)
    return np.stack([x + 100.0, y - 50.0, heading], -1)


def write_kitti(path: Path, poses: np.ndarray) -> None:
    """Camera poses: x right, y down, z forward; the world is such a camera's frame too."""
    lines = []
    for x, y, heading in poses:
        cos, sin = np.cos(heading), np.sin(heading)
        matrix = [[cos, 0, -sin, -y], [0, 1, 0, 0.3], [sin, 0, cos, x]]
        lines.append(" ".join(f"{v:.9e}" for v in np.ravel(matrix)))
    path.write_text("\n".join(lines) + "\n")


def write_novatel(folder: Path, poses: np.ndarray, *, first: int = 0, turn: float = 0.0) -> None:
    """turn: of the unit in the vehicle, rad; -pi/2 where its y axis looks forward."""
    folder.mkdir(parents=True, exist_ok=True)
    for number, (x, y, heading) in enumerate(poses, first):
        cos, sin = np.cos(heading + turn), np.sin(heading + turn)
        content = {
            "rotation": [[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]],
            "translation": [[x], [y], [12.0]],
        }
        (folder / f"{number:06d}.json").write_text(json.dumps(content))


def test_a_circle_is_a_circle_to_the_left_in_every_ego_frame(tmp_path: Path) -> None:
    write_kitti(tmp_path / "00.txt", circle())
    cut = cut_trajectories(read_poses(tmp_path), CutConfig(steps=21, stride=7, heading=True))
    assert cut.positions.shape == (6, 21, 3)
    turned = np.arange(21) * DT * SPEED / RADIUS
    expected = np.stack([RADIUS * np.sin(turned), RADIUS * (1 - np.cos(turned)), turned], -1)
    for positions in cut.positions:
        np.testing.assert_allclose(positions, expected, atol=1e-6)
    # A window's own ends have the whole drive's differences, except at the drive's ends.
    np.testing.assert_allclose(cut.velocities[1, 0], [SPEED, 0.0, SPEED / RADIUS], atol=1e-3)
    np.testing.assert_allclose(cut.accelerations[1, 0, :2], [0.0, SPEED**2 / RADIUS], atol=1e-3)


def test_both_formats_say_the_same(tmp_path: Path) -> None:
    (tmp_path / "kitti").mkdir()
    write_kitti(tmp_path / "kitti" / "07.txt", circle())
    write_novatel(tmp_path / "dair" / "vehicle-side" / "calib" / "novatel_to_world", circle())
    kitti, dair = (cut_trajectories(read_poses(tmp_path / f)) for f in ("kitti", "dair"))
    assert kitti.positions.shape == (4, 45, 2)
    np.testing.assert_allclose(kitti.positions, dair.positions, atol=1e-6)
    assert kitti.sequence_names == ("07",)
    one_file = cut_trajectories(read_poses(tmp_path / "kitti" / "07.txt"))
    np.testing.assert_array_equal(one_file.positions, kitti.positions)
    json_folder = tmp_path / "dair" / "vehicle-side" / "calib" / "novatel_to_world"
    np.testing.assert_array_equal(
        cut_trajectories(read_poses(json_folder)).positions, dair.positions
    )


@pytest.mark.parametrize("turn", [0.0, -np.pi / 2, np.pi / 2, np.pi])
def test_the_mounting_of_the_unit_is_found(turn: float, tmp_path: Path) -> None:
    write_novatel(tmp_path / "novatel_to_world", circle(), turn=turn)
    cut = cut_trajectories(read_poses(tmp_path), CutConfig(steps=21, heading=True))
    # The chord of a left turn lies a little to the left, all of it ahead.
    assert (np.diff(cut.positions[..., 0], axis=1) > 0).all()
    np.testing.assert_allclose(cut.positions[:, -1, 2], 20 * DT * SPEED / RADIUS, atol=1e-6)


def test_data_info_parts_drives_and_tells_the_times(tmp_path: Path) -> None:
    side = tmp_path / "vehicle-side"
    folder = side / "calib" / "novatel_to_world"
    write_novatel(folder, circle(50))
    write_novatel(folder, circle(50, start=2.0), first=50)
    # 5 Hz recordings, listed in disorder; the second drive's numbers follow the first's at once.
    entries = [
        {
            "image_path": f"image/{number:06d}.jpg",
            "calib_novatel_to_world_path": f"calib/novatel_to_world/{number:06d}.json",
            "pointcloud_timestamp": str(1626155123000000 + number * 200_000),
            "batch_id": str(number // 50),
        }
        for number in np.random.default_rng(0).permutation(100)
    ]
    (side / "data_info.json").write_text(json.dumps(entries))
    tracks = read_poses(tmp_path)
    assert [track.name for track in tracks] == ["0", "1"]
    np.testing.assert_allclose(np.diff(tracks[0].times), 0.2, atol=1e-6)
    cut = cut_trajectories(tracks, CutConfig(steps=21, rate_hz=10.0, stride=1))
    assert cut.dt == 0.1
    assert len(cut.positions) == 2 * (99 - 21 + 1)
    # Half as fast as the circle was written: between two poses the path is interpolated.
    step = np.linalg.norm(np.diff(cut.positions, axis=1), axis=-1)
    np.testing.assert_allclose(step, SPEED * DT / 2, rtol=1e-4)


def test_nothing_is_cut_across_a_gap_or_a_bad_pose() -> None:
    times = np.linspace(0.0, 9.9, 100)
    times[50:] += 3.0
    poses = circle(100)
    poses[75, 0] = np.nan
    cut = cut_trajectories([PoseTrack("d", times, poses)], CutConfig(steps=21, stride=1))
    assert cut.bad_poses == 1
    # One missing pose is bridged, a silence of seconds is not.
    assert len(cut.positions) == 2 * 30
    assert (cut.start_s[:30] + 2.0 <= times[49] + 1e-6).all()
    assert (cut.start_s[30:] >= times[50]).all()
    np.testing.assert_allclose(cut.positions, cut.positions[:1].repeat(60, 0), atol=1e-5)


def test_the_real_drive_makes_a_dataset(shared_data: Callable[[str], Path], tmp_path: Path) -> None:
    tracks = read_poses(shared_data("kitti_00_poses.txt"))
    for heading in (False, True):
        cut = cut_trajectories(tracks, CutConfig(heading=heading))
        cut.save(tmp_path / "kitti.npz")
        dataset = TrajectoryDataset(tmp_path / "kitti.npz")
        assert (dataset.num_steps, dataset.dim) == (45, 3 if heading else 2)
        assert dataset.dt == pytest.approx(0.1)
        assert len(dataset) == (1500 - 45) // 5 + 1
        sample = dataset.read(slice(None))
        np.testing.assert_array_equal(sample["positions"][:, 0], 0)
        # A car drives forward, at a town's speed, and its path agrees with its velocity.
        assert (sample["positions"][:, -1, 0] > -1).all()
        assert 5 < np.median(dataset.peak_speed) < 20
        assert dataset.peak_acceleration.max() < 15
        rate = np.diff(sample["positions"], axis=1) / 0.1
        np.testing.assert_allclose(rate[..., :2], sample["velocities"][:, 1:, :2], atol=1.5)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1 2 3\n", r"00\.txt, line 1: expected 12 numbers.*found 3"),
        ("1 0 0 0 0 1 0 0 0 0 1 0\n1 2 x\n", r"00\.txt, line 2: .*'x'"),
        ("", r"00\.txt: expected poses, found an empty file"),
        ("1 0 0 0 0 1 0 0 0 0 1 0\n" * 9, r"at least 45 steps at 10 Hz.*1 drives of at most 9"),
    ],
)
def test_a_broken_pose_file_is_named(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "00.txt").write_text(text)
    with pytest.raises(DatasetError, match=said):
        cut_trajectories(read_poses(tmp_path))


def test_broken_json_is_named(tmp_path: Path) -> None:
    folder = tmp_path / "novatel_to_world"
    write_novatel(folder, circle(3))
    (folder / "000001.json").write_text(json.dumps({"rotation": [[1, 0], [0, 1]]}))
    with pytest.raises(DatasetError, match=r"000001\.json: rotation: expected \[3, 3\].*\[2, 2\]"):
        read_poses(tmp_path)
    (folder / "000001.json").write_text(json.dumps({"rotation": np.eye(3).tolist()}))
    with pytest.raises(DatasetError, match=r"000001\.json: translation"):
        read_poses(tmp_path)
    (folder / "000001.json").write_text("{")
    with pytest.raises(DatasetError, match=r"000001\.json: Expecting"):
        read_poses(tmp_path)
    with pytest.raises(DatasetError, match=r"empty: expected KITTI pose files"):
        read_poses(tmp_path / "empty")


def test_the_output_must_be_an_npz(tmp_path: Path) -> None:
    cut = cut_trajectories([PoseTrack("d", np.linspace(0.0, 5.9, 60), circle())])
    with pytest.raises(DatasetError, match=r"out\.npy: expected a name that ends in \.npz"):
        cut.save(tmp_path / "out.npy")
