"""A trajectory file as a torch dataset, and its batches."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, default_collate

from anchorflow_models.generation.scenes import as_numpy
from anchorflow_training.data.array_layout import (
    GEOMETRY_ARRAYS,
    KNOWN_ARRAYS,
    SAMPLE_ARRAYS,
    Seconds,
    by_own_names,
    check_layout,
    check_values,
    time_step,
)
from anchorflow_training.data.file_formats import (
    ArraySource,
    HeldArray,
    Rows,
    open_arrays,
    read_whole,
)
from anchorflow_training.data.statistics import (
    FIELDS,
    Survey,
    Surveyor,
    TrajectoryStatistics,
    central_differences,
    unwrap_heading,
)
from anchorflow_training.dataset import DatasetError

Sample = dict[str, Tensor]
Own = TypeVar("Own", bound="TrajectoryDataset")

BLOCK_BYTES = 1 << 23  # of a file that are looked at together; bounds the memory of a pass
LEAST_WALL = 128  # of 8 bits; maps that stay below it hold 0 and 1, or percent


class TrajectoryDataset(Dataset[Sample]):
    """The samples of a trajectory file; `array_layout` lists its arrays.

    Opening makes one pass over the file, in blocks, for statistics and for rows with a NaN or an
    infinity. Those rows are left out: `len(dataset)` counts, and indices run over, the others.

    A subclass may override `__getitem__` to change samples: batches, statistics, peaks and the
    import of scenes then take what it returns.

    path: the file
    count: N of the file; rows: [n] rows of the file that are samples here; left_out: [m] the others
    not_finite: which rows of which array are not finite
    num_steps: T; dim: D
    dt: s between two steps, [N] where the file says it of each row and they differ; None where
        neither the file nor the caller says
    statistics: mean, standard deviation and range of p, v, a over the samples
    peak_speed, peak_acceleration: [n] greatest planar length along each sample, m/s and m/s^2
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
        resolution: m/cell of the cost maps; overrides the file
        statistics: those of other data, to normalise by

        Raises `DatasetError`.
        """
        arrays = open_arrays(Path(path), allow_pickle=allow_pickle)
        self._open(
            Path(path),
            arrays,
            dt=dt,
            horizon_s=horizon_s,
            resolution=resolution,
            statistics=statistics,
        )

    @classmethod
    def from_arrays(
        cls: type[Own],
        arrays: Mapping[str, ArrayLike | Tensor],
        *,
        name: str = "arrays",
        **how: Any,
    ) -> Own:
        """Return the samples of arrays in memory, by the names that `array_layout` lists.

        name: what errors and datasets call them
        how: the keywords of `TrajectoryDataset`, such as dt, but for allow_pickle
        """
        held = {each: HeldArray(np.asarray(as_numpy(values))) for each, values in arrays.items()}
        dataset = cls.__new__(cls)
        dataset._open(Path(name), held, **how)
        return dataset

    def _open(
        self,
        path: Path,
        arrays: Mapping[str, ArraySource],
        *,
        dt: float | None = None,
        horizon_s: float | None = None,
        resolution: float | None = None,
        statistics: TrajectoryStatistics | None = None,
    ) -> None:
        if resolution is not None:
            arrays = {**arrays, "resolution": HeldArray(np.asarray(resolution))}
        if statistics is not None:
            self.statistics = statistics
        arrays = by_own_names(path, arrays)
        check_layout(path, arrays)
        self.path = path
        self.arrays = {name: arrays[name] for name in SAMPLE_ARRAYS if name in arrays}
        self.ignored = tuple(name for name in arrays if name not in KNOWN_ARRAYS)
        self.count, self.num_steps, self.dim = self.arrays["positions"].shape
        self.geometry = {
            name: read_whole(arrays[name]) for name in GEOMETRY_ARRAYS if name in arrays
        }
        self.dt = time_step(path, arrays, num_steps=self.num_steps, dt=dt, horizon_s=horizon_s)
        self._file_survey = self._surveyed_file()

    @property
    def durations(self) -> NDArray[np.float64] | None:
        """[n] s that each sample lasts; None where that is unknown."""
        if self.dt is None:
            return None
        return np.broadcast_to(self.dt, self.count)[self.rows] * (self.num_steps - 1)

    @property
    def horizon_s(self) -> float | None:
        """s that every sample lasts; None where they differ, or where that is unknown."""
        return self.dt * (self.num_steps - 1) if isinstance(self.dt, float) else None

    @cached_property
    def statistics(self) -> TrajectoryStatistics:
        found = self._survey.statistics
        assert found is not None  # opening refuses a file without a finite row
        return found

    @cached_property
    def peak_speed(self) -> NDArray[np.float32]:
        return self._survey.peak_speed[self._survey.finite]

    @cached_property
    def peak_acceleration(self) -> NDArray[np.float32]:
        return self._survey.peak_acceleration[self._survey.finite]

    @cached_property
    def _survey(self) -> Survey:
        """The survey of the samples; lazy, since a subclass must be constructed first."""
        return self._surveyed_samples() if self._overridden else self._file_survey

    def _surveyed_file(self) -> Survey:
        surveyor, greatest = Surveyor(), 0
        for rows in self._blocks(self.count):
            block = {name: array.read(rows) for name, array in self.arrays.items()}
            for name, values in block.items():
                check_values(self.path, name, values, rows.start)
            if "cost_maps" in block and block["cost_maps"].dtype == np.uint8:
                greatest = max(greatest, int(block["cost_maps"].max()))
            # Rows that are not finite pass through here before anyone knows them.
            with np.errstate(invalid="ignore", over="ignore"):
                surveyor.add(rows.start, block, self._states(block, self._steps_of(rows)))
        if 0 < greatest < LEAST_WALL:
            raise DatasetError(
                f"{self.path}: cost_maps: expected 255 for 1 in 8 bits, found at most {greatest}"
            )
        for name, values in self.geometry.items():
            if not np.isfinite(values).all():
                raise DatasetError(f"{self.path}: {name}: expected finite numbers")
            check_values(self.path, name, values.reshape(-1, 1), 0)
        found = surveyor.result()
        if found.statistics is None:
            raise DatasetError(f"{self.path}: expected a row of finite numbers, found none")
        self.not_finite = found.not_finite
        self.rows, self.left_out = np.flatnonzero(found.finite), np.flatnonzero(~found.finite)
        return found

    def _surveyed_samples(self) -> Survey:
        surveyor = Surveyor()
        for part in self._blocks(len(self)):
            block = self.samples(range(part.start, part.stop), np.float64)
            surveyor.add(part.start, block, [block[name] for name in FIELDS])
        return surveyor.result()

    def _blocks(self, count: int) -> Iterator[slice]:
        row_bytes = sum(a.dtype.itemsize * int(np.prod(a.shape[1:])) for a in self.arrays.values())
        step = max(1, BLOCK_BYTES // row_bytes)
        for start in range(0, count, step):
            yield slice(start, min(start + step, count))

    def _steps_of(self, rows: Rows) -> Seconds:
        """s between two steps of rows of the file."""
        if self.dt is None:
            return np.nan
        return self.dt[rows] if isinstance(self.dt, np.ndarray) else self.dt

    def _states(
        self, block: Mapping[str, NDArray[Any]], dt: Seconds
    ) -> tuple[NDArray[np.floating], ...]:
        """Positions, velocities and accelerations [n, T, D] of a block."""
        position = unwrap_heading(np.asarray(block["positions"], np.float64))
        velocity, acceleration = block.get("velocities"), block.get("accelerations")
        if velocity is None:
            velocity = central_differences(position, dt)
        if acceleration is None:
            velocity = np.asarray(velocity, np.float64)
            acceleration = central_differences(velocity, dt)
        return position, velocity, acceleration

    def read(
        self, samples: Rows, dtype: type[np.floating] = np.float32
    ) -> dict[str, NDArray[np.floating]]:
        """Samples by index as the file has them, in SI units; cost_maps in [0, 1].

        positions, velocities, accelerations [B, T, D], and the file's other arrays by their names.
        """
        rows = self.rows[samples]
        block = {name: array.read(rows) for name, array in self.arrays.items()}
        if "cost_maps" in block and block["cost_maps"].dtype == np.uint8:
            block["cost_maps"] = block["cost_maps"] / np.float32(255)
        block |= dict(zip(FIELDS, self._states(block, self._steps_of(rows)), strict=True))
        return {name: np.asarray(values, dtype) for name, values in block.items()}

    def samples(
        self, indices: Sequence[int] | NDArray[np.int64], dtype: type[np.floating] = np.float32
    ) -> dict[str, NDArray[np.floating]]:
        """Samples by index as training takes them: `read`, or what a subclass makes of it.

        Raises `DatasetError` if a subclass returns something else than samples.
        """
        if not self._overridden:
            return self.read(np.asarray(indices, np.int64), dtype)
        found = stacked(self.__getitems__([int(index) for index in indices]))
        batch = {name: np.asarray(values, dtype) for name, values in found.items()}
        self._check_overridden(batch, indices)
        return batch

    @property
    def _overridden(self) -> bool:
        own = ("__getitem__", "__getitems__", "read")
        return any(getattr(type(self), n) is not getattr(TrajectoryDataset, n) for n in own)

    def _check_overridden(
        self, batch: Mapping[str, NDArray[np.floating]], indices: Sequence[int] | NDArray[np.int64]
    ) -> None:
        where = f"{self.path}, as {type(self).__name__} returns it"
        shape = len(indices), self.num_steps, self.dim
        for name in FIELDS:
            if name not in batch or batch[name].shape != shape:
                found = list(batch[name].shape[1:]) if name in batch else "none"
                raise DatasetError(
                    f"{where}: {name}: expected {list(shape[1:])} in each sample, found {found}"
                )
        for name, values in batch.items():
            bad = np.flatnonzero(~np.isfinite(values.reshape(len(values), -1)).all(1))
            if len(bad):
                raise DatasetError(
                    f"{where}: {name}: expected finite numbers in sample {indices[bad[0]]}"
                )
            check_values(where, name, values, int(indices[0]))

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
        """One sample as float32 tensors, without the B axis; a subclass may override it."""
        found = self.read(np.asarray([range(len(self))[index]], np.int64))
        return {name: values[0] for name, values in _tensors(found).items()}

    def __getitems__(self, indices: Sequence[int]) -> Sample:
        """A batch [B, ...]; torch's loader calls it with all indices of a batch."""
        if type(self).__getitem__ is not TrajectoryDataset.__getitem__:
            return stacked([self[index] for index in indices])
        return _tensors(self.read(np.asarray(indices, np.int64)))


def stacked(batch: Sample | list[Sample]) -> Sample:
    """Return a batch as one sample [B, ...]; a subclass's `__getitems__` may list samples."""
    return default_collate(batch) if isinstance(batch, list) else batch


def _tensors(arrays: Mapping[str, NDArray[np.floating]]) -> Sample:
    return {name: torch.from_numpy(np.ascontiguousarray(a)) for name, a in arrays.items()}


def create_dataloader(
    dataset: TrajectoryDataset,
    batch_size: int,
    *,
    shuffle: bool = True,
    seed: int = 0,
    normalise: bool = False,
    drop_last: bool = False,
    workers: int = 0,
) -> DataLoader[Sample]:
    """Batches of `batch_size` samples: what a sample of the dataset names, as tensors [B, ...].

    seed: the order of every epoch follows from it and from the epochs before
    normalise: positions, velocities and accelerations by `dataset.statistics`
    workers: processes that read ahead; each opens the file for itself
    """
    return DataLoader(
        dataset,
        batch_size,
        shuffle=shuffle,
        generator=torch.Generator().manual_seed(seed),
        collate_fn=partial(_collate, dataset.statistics if normalise else None),
        num_workers=workers,
        drop_last=drop_last,
    )


def _collate(statistics: TrajectoryStatistics | None, batch: Any) -> Sample:
    batch = stacked(batch)
    if statistics is None:
        return batch
    scaled = {
        name: torch.from_numpy(getattr(statistics, name).normalise(batch[name].numpy()))
        for name in FIELDS
    }
    return batch | scaled
