"""Ego-centred trajectories, cut from recorded poses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from anchorflow_training.data.array_layout import LEAST_STEPS
from anchorflow_training.data.derivatives import central_differences
from anchorflow_training.data.pose_files import PoseTrack
from anchorflow_training.dataset import DatasetError

FloatArray = NDArray[np.floating]

LONGEST_GAP_S = 0.5
"""A longer silence parts a drive in two: nobody knows what the vehicle did in it."""

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
