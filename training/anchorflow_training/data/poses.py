"""Recorded poses of a vehicle, and ego-centred trajectories cut from them."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from anchorflow_training.data.array_layout import LEAST_STEPS
from anchorflow_training.data.statistics import central_differences
from anchorflow_training.dataset import DatasetError

NOVATEL = "novatel_to_world"
SEQUENCE_KEYS = ("batch_id", "sequence_id")
TIME_KEYS = ("pointcloud_timestamp", "image_timestamp")
SECONDS = 1e-6  # of a timestamp's unit
MOVING = 0.05  # m between two poses, from which their direction means something


@dataclass(frozen=True)
class PoseTrack:
    """One drive: times [P] s, rising; poses [P, 3] x, y in m and heading in rad, z axis up."""

    name: str
    times: NDArray[np.float64]
    poses: NDArray[np.float64]


def read_poses(path: Path, *, pose_rate_hz: float = 10.0) -> list[PoseTrack]:
    """The drives under a folder, or in one KITTI file; `pose_rate_hz` where no times are recorded.

    Raises `DatasetError`, naming the file and the line, or saying that there are no poses.
    """
    if path.is_file():
        return [read_kitti(path, pose_rate_hz)]
    folders = sorted(path.rglob(NOVATEL)) if path.is_dir() else []
    if not folders and any(path.glob("*.json")):
        folders = [path]
    if folders:
        return [track for folder in folders for track in read_novatel(folder, pose_rate_hz)]
    files = sorted(path.glob("*.txt"))
    if not files:
        raise DatasetError(
            f"{path}: expected KITTI pose files *.txt, a folder {NOVATEL} or its *.json, found none"
        )
    return [read_kitti(file, pose_rate_hz) for file in files]


def read_kitti(file: Path, pose_rate_hz: float) -> PoseTrack:
    """One sequence in its first camera's frame: x forward, y left."""
    rows = []
    try:
        text = file.read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise DatasetError(f"{file}: {error}") from error
    for number, line in enumerate(text.splitlines(), 1):
        values = line.split()
        try:
            rows.append([float(value) for value in values])
        except ValueError as error:
            raise DatasetError(f"{file}, line {number}: {error}") from error
        if len(values) != 12:
            raise DatasetError(
                f"{file}, line {number}: expected 12 numbers, the rows of a 3x4 pose, "
                f"found {len(values)}"
            )
    if not rows:
        raise DatasetError(f"{file}: expected poses, found an empty file")
    matrix = np.array(rows).reshape(-1, 3, 4)
    right, _, forward = np.moveaxis(matrix[:, :, 3], -1, 0)
    heading = np.arctan2(-matrix[:, 0, 2], matrix[:, 2, 2])
    times = np.arange(len(rows)) / pose_rate_hz
    return PoseTrack(file.stem, times, np.stack([forward, -right, np.unwrap(heading)], -1))


def read_novatel(folder: Path, pose_rate_hz: float) -> list[PoseTrack]:
    """The drives of a folder of JSON files, in the world's frame."""
    files = {file.stem: file for file in sorted(folder.glob("*.json"))}
    if not files:
        raise DatasetError(f"{folder}: expected poses *.json, found none")
    drives = _drives(folder, files, pose_rate_hz)
    matrices = [np.stack([novatel_pose(files[f]) for f, _ in drive]) for drive in drives.values()]
    axis = forward_axis(matrices)
    tracks = []
    for (name, drive), matrix in zip(drives.items(), matrices, strict=True):
        times = np.array([time for _, time in drive])
        tracks.append(PoseTrack(name, times, planar_poses(matrix, axis)))
    return tracks


Drive = list[tuple[str, float]]
"""Frames of one drive: a file's stem and its time [s], in order."""


def _drives(folder: Path, files: dict[str, Path], pose_rate_hz: float) -> dict[str, Drive]:
    info = folder.parent.parent / "data_info.json"
    frames: list[tuple[str, str, float]] = []
    if info.exists():
        for entry in data_entries(info):
            stem = Path(str(entry.get(f"calib_{NOVATEL}_path") or entry.get("image_path"))).stem
            if stem in files:
                sequence = _first(info, entry, SEQUENCE_KEYS)
                frames.append((sequence, stem, microseconds(info, entry) * SECONDS))
    else:
        for stem in files:
            number = re.search(r"\d+$", stem)
            if number is None:
                raise DatasetError(
                    f"{files[stem]}: expected a name that ends in its frame's number"
                )
            frames.append((folder.name, stem, int(number[0]) / pose_rate_hz))
    drives: dict[str, Drive] = {}
    for sequence, stem, time in sorted(frames, key=lambda frame: (frame[0], frame[2])):
        drive = drives.setdefault(sequence, [])
        if not drive or time > drive[-1][1]:  # the same instant twice says nothing new
            drive.append((stem, time))
    if not drives:
        raise DatasetError(f"{info}: names no file of {folder}")
    return drives


def data_entries(info: Path) -> list[dict[str, Any]]:
    found = read_json(info)
    if not isinstance(found, list) or not all(isinstance(entry, dict) for entry in found):
        raise DatasetError(f"{info}: expected a list of objects, an entry a frame")
    return found


def microseconds(info: Path, entry: dict[str, Any]) -> float:
    text = _first(info, entry, TIME_KEYS)
    try:
        return float(text)
    except ValueError as error:
        raise DatasetError(f"{info}: expected a time in microseconds, found {text!r}") from error


def _first(info: Path, entry: dict[str, Any], keys: Sequence[str]) -> str:
    for key in keys:
        if key in entry:
            return str(entry[key])
    raise DatasetError(f"{info}: expected {' or '.join(keys)} in each entry, found {sorted(entry)}")


def novatel_pose(file: Path) -> NDArray[np.float64]:
    """[3, 4]: rotation and translation."""
    found = read_json(file)
    if not isinstance(found, dict):
        raise DatasetError(f"{file}: expected an object with rotation and translation")
    parts = []
    for key, shape in (("rotation", (3, 3)), ("translation", (3, 1))):
        try:
            values = np.asarray(found[key], float)
        except KeyError as error:
            raise DatasetError(f"{file}: {key}: expected {list(shape)}, found none") from error
        except (TypeError, ValueError) as error:
            raise DatasetError(
                f"{file}: {key}: expected numbers {list(shape)} ({error})"
            ) from error
        if values.size != np.prod(shape):
            raise DatasetError(f"{file}: {key}: expected {list(shape)}, found {list(values.shape)}")
        parts.append(values.reshape(shape))
    return np.concatenate(parts, 1)


def planar_poses(matrices: NDArray[np.float64], axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return x, y [m] and heading [rad] of matrices [P, 3, 4] as [P, 3]; axis: `forward_axis`."""
    ahead = matrices[:, :2, :3] @ axis
    heading = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))
    return np.concatenate([matrices[:, :2, 3], heading[:, None]], 1)


def forward_axis(drives: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """The vehicle's axis [3] along which it drives: x or y, by the unit's mounting."""
    # Published copies do not agree on which it is, but vehicles drive forward nearly always.
    forward = np.zeros(3)
    for matrix in drives:
        step = np.diff(matrix[:, :2, 3], axis=0)
        length = np.linalg.norm(step, axis=1)
        moving = length > MOVING
        forward += np.einsum(
            "pi,pij->j", step[moving] / length[moving, None], matrix[:-1, :2, :3][moving]
        )
    forward[2] = 0.0
    if not np.any(np.isfinite(forward) & (forward != 0.0)):
        return np.array([1.0, 0.0, 0.0])
    axis = np.zeros(3)
    strongest = int(np.argmax(np.abs(forward)))
    axis[strongest] = np.sign(forward[strongest])
    return axis


def read_json(file: Path) -> Any:
    try:
        return json.loads(file.read_text())
    except (OSError, ValueError) as error:
        raise DatasetError(f"{file}: {error}") from error


FloatArray = NDArray[np.floating]

LONGEST_GAP_S = 0.5
"""A longer gap splits a drive in two."""

FASTEST_HZ = 1000.0  # between recorded poses there is nothing more to be known


@dataclass(frozen=True)
class CutConfig:
    """steps: T; rate_hz: of the trajectories; stride: steps from one start to the next;
    heading: whether the heading [rad] is the third dimension."""

    steps: int = 45
    rate_hz: float = 10.0
    stride: int = 5
    heading: bool = False


@dataclass(frozen=True)
class CutTrajectories:
    """In the vehicle's frame at each trajectory's first step: x forward, y left.

    positions, velocities, accelerations: [N, T, D]; dt: s
    sequence: [N] index into sequence_names; start_s: [N] s, when each begins in its drive
    bad_poses: poses that were not finite; LONGEST_GAP_S and less of them were interpolated
    """

    positions: FloatArray
    velocities: FloatArray
    accelerations: FloatArray
    dt: float
    sequence: NDArray[np.int64]
    start_s: FloatArray
    sequence_names: tuple[str, ...]
    bad_poses: int

    def save(self, path: Path) -> None:
        """Write an `.npz` that `TrajectoryDataset` maps; raises `DatasetError`."""
        if path.suffix != ".npz":
            raise DatasetError(f"{path}: expected a name that ends in .npz")
        arrays = {
            name: getattr(self, name).astype(np.float32)
            for name in ("positions", "velocities", "accelerations")
        }
        try:
            np.savez(
                path,
                **arrays,
                dt=np.float64(self.dt),
                sequence=self.sequence,
                start_s=self.start_s,
                sequence_names=np.array(self.sequence_names),
            )
        except OSError as error:
            raise DatasetError(f"{path}: {error}") from error


def cut_trajectories(
    tracks: Sequence[PoseTrack], config: CutConfig | None = None
) -> CutTrajectories:
    """Windows of `config.steps` steps from every drive; raises `DatasetError` where none fits.

    Velocities and accelerations are differences along the whole drive, so those at a window's ends
    know what lies beyond it.
    """
    config = config or CutConfig()
    if config.steps < LEAST_STEPS:
        raise DatasetError(f"steps: expected at least {LEAST_STEPS}, got {config.steps}")
    if not 0 < config.rate_hz <= FASTEST_HZ:
        raise DatasetError(
            f"rate_hz: expected above 0 and at most {FASTEST_HZ:g} Hz, got {config.rate_hz:g}"
        )
    dt, windows, sequence, starts = 1.0 / config.rate_hz, [], [], []
    for index, track in enumerate(tracks):
        for began, poses in steady_pieces(track, config.rate_hz):
            if len(poses) < config.steps:
                continue
            velocity = central_differences(poses, dt)
            orders = np.stack([poses, velocity, central_differences(velocity, dt)])
            for start in range(0, len(poses) - config.steps + 1, config.stride):
                windows.append(ego_centred(orders[:, start : start + config.steps]))
                sequence.append(index)
                starts.append(began + start * dt)
    bad_poses = sum(int((~np.isfinite(track.poses).all(1)).sum()) for track in tracks)
    if not windows:
        longest = max((len(track.times) for track in tracks), default=0)
        raise DatasetError(
            f"expected a drive of at least {config.steps} steps at {config.rate_hz:g} Hz without a "
            f"gap, found {len(tracks)} drives of at most {longest} poses"
            + (f", {bad_poses} of them not finite" if bad_poses else "")
        )
    dim = 3 if config.heading else 2
    position, velocity, acceleration = np.moveaxis(np.stack(windows)[..., :dim], 1, 0)
    return CutTrajectories(
        positions=position,
        velocities=velocity,
        accelerations=acceleration,
        dt=dt,
        sequence=np.array(sequence),
        start_s=np.array(starts),
        sequence_names=tuple(track.name for track in tracks),
        bad_poses=bad_poses,
    )


def steady_pieces(track: PoseTrack, rate_hz: float) -> Iterator[tuple[float, FloatArray]]:
    """Pieces of a drive without a gap, at a steady rate: when each begins [s], and its poses."""
    finite = np.isfinite(track.poses).all(1)
    times, poses = track.times[finite], track.poses[finite].copy()
    poses[:, 2] = np.unwrap(poses[:, 2])
    gaps = np.flatnonzero(np.diff(times) > LONGEST_GAP_S) + 1
    for rows in np.split(np.arange(len(times)), gaps):
        if len(rows) < LEAST_STEPS:
            continue
        own = times[rows] - times[rows[0]]
        steps = int(np.floor(own[-1] * rate_hz + 1e-6)) + 1
        wanted = np.minimum(np.arange(steps) / rate_hz, own[-1])
        on_grid = steps == len(rows) and np.allclose(wanted, own, atol=1e-6)
        yield (
            float(times[rows[0]]),
            poses[rows] if on_grid else CubicSpline(own, poses[rows])(wanted),
        )


def ego_centred(orders: FloatArray) -> FloatArray:
    """A window [3, T, 3] of p, v, a of (x, y, heading) in the frame of its first pose."""
    heading = orders[0, 0, 2]
    cos, sin = np.cos(heading), np.sin(heading)
    # Rows are vectors, so this turns by minus the heading.
    turned = orders @ np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    turned[0] -= turned[0, 0]
    return turned
