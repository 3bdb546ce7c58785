"""Trajectories of a file, left on disk, as torch samples and batches."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import Dataset

from anchorflow_training.data.array_layout import (
    GEOMETRY_ARRAYS,
    SAMPLE_ARRAYS,
    SCALARS,
    check_layout,
    check_values,
)
from anchorflow_training.data.array_source import ArraySource, HeldArray, Rows, read_whole
from anchorflow_training.data.derivatives import central_differences, unwrap_heading
from anchorflow_training.data.file_formats import open_arrays
from anchorflow_training.data.statistics import FIELDS, Surveyor, TrajectoryStatistics
from anchorflow_training.dataset import DatasetError

Sample = dict[str, Tensor]

BLOCK_BYTES = 1 << 23  # of a file that are looked at together; bounds the memory of a pass


class TimeStepUnknown(DatasetError):
    """Derivatives are to be taken, and nobody says how far in time two steps lie apart."""


class TrajectoryDataset(Dataset[Sample]):
    """The samples of a `.npz`, `.npy`, `.h5` or `.pkl` file; `array_layout` lists its arrays.

    Opening makes one pass over the file, in blocks, for statistics and for rows with a NaN or an
    infinity. Those rows are left out: `len(dataset)` counts, and indices run over, the others.

    path: the file
    count: N of the file; rows: [n] rows of the file that are samples here; left_out: [m] the others
    not_finite: which rows of which array are not finite
    num_steps: T; dim: D; dt, horizon_s: s, None where neither the file nor the caller says
    statistics: mean, standard deviation and range of p, v, a over the samples
    peak_speed, peak_acceleration: [N] greatest planar length along each row, m/s and m/s^2
    """

    def __init__(
        self,
        path: str | Path,
        *,
        dt: float | None = None,
        horizon_s: float | None = None,
        resolution: float | None = None,
        allow_pickle: bool = False,
        statistics: TrajectoryStatistics | None = None,
    ) -> None:
        """Opens `path`.

        dt, horizon_s: s, either says the other; they go before what the file says
        resolution: m/cell of the cost maps; it goes before what the file says
        statistics: those of other data, to normalise by

        Raises:
            DatasetError: naming the file, the array, the expected and the found shape.
        """
        arrays = open_arrays(Path(path), allow_pickle=allow_pickle)
        if resolution is not None:
            arrays["resolution"] = HeldArray(np.asarray(resolution))
        self._open(Path(path), arrays, dt, horizon_s)
        if statistics is not None:
            self.statistics = statistics

    def _open(
        self,
        path: Path,
        arrays: Mapping[str, ArraySource],
        dt: float | None,
        horizon_s: float | None,
    ) -> None:
        check_layout(path, arrays)
        self.path, self.sources = path, arrays
        self.arrays = {name: arrays[name] for name in SAMPLE_ARRAYS if name in arrays}
        known = (*SAMPLE_ARRAYS, *GEOMETRY_ARRAYS, *SCALARS)
        self.ignored = tuple(name for name in arrays if name not in known)
        self.count, self.num_steps, self.dim = self.arrays["positions"].shape
        self.geometry = {
            name: read_whole(arrays[name]) for name in GEOMETRY_ARRAYS if name in arrays
        }
        self.dt = self._time_step(dt, horizon_s)
        self._survey()

    @property
    def horizon_s(self) -> float | None:
        return None if self.dt is None else self.dt * (self.num_steps - 1)

    def _time_step(self, dt: float | None, horizon_s: float | None) -> float | None:
        if dt is None and horizon_s is None:
            dt, horizon_s = (
                float(read_whole(self.sources[name])) if name in self.sources else None
                for name in SCALARS
            )
        steps = self.num_steps - 1
        for name, value in (("dt", dt), ("horizon_s", horizon_s)):
            if value is not None and not 0 < value < np.inf:
                raise DatasetError(f"{self.path}: {name}: expected seconds above 0, found {value}")
        if dt is not None and horizon_s is not None and not np.isclose(dt * steps, horizon_s, 1e-4):
            raise DatasetError(
                f"{self.path}: expected horizon_s = dt (T - 1) = {dt * steps:g} s, "
                f"found {horizon_s:g} s"
            )
        if dt is None and horizon_s is not None:
            dt = horizon_s / steps
        if dt is None and not {"velocities", "accelerations"} <= set(self.arrays):
            raise TimeStepUnknown(
                f"{self.path}: dt: expected the time step or horizon_s, in s (--dt, --horizon-s), "
                "to differentiate the positions by, found neither"
            )
        return dt

    def _survey(self) -> None:
        surveyor = Surveyor()
        for rows in self._blocks():
            block = {name: array.read(rows) for name, array in self.arrays.items()}
            for name, values in block.items():
                check_values(self.path, name, values, rows.start)
            # Rows that are not finite pass through here before anyone knows them.
            with np.errstate(invalid="ignore", over="ignore"):
                surveyor.add(rows.start, block, self._states(block))
        for name, values in self.geometry.items():
            if not np.isfinite(values).all():
                raise DatasetError(f"{self.path}: {name}: expected finite numbers")
            check_values(self.path, name, values.reshape(-1, 1), 0)
        found = surveyor.result()
        if found.statistics is None:
            raise DatasetError(f"{self.path}: expected a row of finite numbers, found none")
        self.statistics, self.not_finite = found.statistics, found.not_finite
        self.peak_speed, self.peak_acceleration = found.peak_speed, found.peak_acceleration
        self.rows, self.left_out = np.flatnonzero(found.finite), np.flatnonzero(~found.finite)

    def _blocks(self) -> Iterator[slice]:
        row_bytes = sum(a.dtype.itemsize * int(np.prod(a.shape[1:])) for a in self.arrays.values())
        step = max(1, BLOCK_BYTES // row_bytes)
        for start in range(0, self.count, step):
            yield slice(start, min(start + step, self.count))

    def _states(self, block: Mapping[str, NDArray[Any]]) -> tuple[NDArray[np.floating], ...]:
        """Positions, velocities and accelerations [n, T, D] of a block."""
        position = unwrap_heading(np.asarray(block["positions"], np.float64))
        velocity, acceleration = block.get("velocities"), block.get("accelerations")
        if velocity is None:
            velocity = central_differences(position, self.dt or np.nan)
        if acceleration is None:
            velocity = np.asarray(velocity, np.float64)
            acceleration = central_differences(velocity, self.dt or np.nan)
        return position, velocity, acceleration

    def read(
        self, samples: Rows, dtype: type[np.floating] = np.float32
    ) -> dict[str, NDArray[np.floating]]:
        """Samples by index, in SI units; cost_maps in [0, 1].

        positions, velocities, accelerations [B, T, D], and the file's other arrays by their names.
        """
        rows = self.rows[samples]
        block = {name: array.read(rows) for name, array in self.arrays.items()}
        if "cost_maps" in block and block["cost_maps"].dtype == np.uint8:
            block["cost_maps"] = block["cost_maps"] / np.float32(255)
        block |= dict(zip(FIELDS, self._states(block), strict=True))
        return {name: np.asarray(values, dtype) for name, values in block.items()}

    def map_geometry(self, samples: Rows) -> NDArray[np.float64] | None:
        """[B, 3]: origin x, origin y [m], resolution [m/cell] of the maps; None if unsaid."""
        if "resolution" not in self.geometry or "cost_maps" not in self.arrays:
            return None
        rows = self.rows[samples]
        resolution = np.broadcast_to(self.geometry["resolution"], self.count)[rows]
        sides = np.asarray(self.arrays["cost_maps"].shape[:1:-1])  # W, H
        centred = -0.5 * resolution[:, None] * sides
        given = self.geometry.get("origin")
        origin = centred if given is None else np.broadcast_to(given, (self.count, 2))[rows]
        return np.concatenate([origin, resolution[:, None]], 1).astype(np.float64)

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, index: int) -> Sample:
        """One sample of `read`, without the B axis."""
        batch = self.__getitems__([range(len(self))[index]])
        return {name: values[0] for name, values in batch.items()}

    def __getitems__(self, indices: Sequence[int]) -> Sample:
        """A batch of `read` as tensors; torch's loader calls it with all indices of a batch."""
        found = self.read(np.asarray(indices, np.int64))
        return {name: torch.from_numpy(np.ascontiguousarray(a)) for name, a in found.items()}
