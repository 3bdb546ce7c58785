"""Arrays that stay on disk: each read takes the rows it is asked for and keeps nothing mapped.

A mapping that outlives its read would count as memory of the process, page by page, until all of
the file is in it; and a memory map pickles as the whole array, which a loader's workers would copy.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import weakref
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Protocol

import numpy as np
from numpy.typing import NDArray

Rows = slice | NDArray[np.int64] | tuple[()]
"""A slice with step 1, indices along the first axis, or () for an array without axes."""


class ArraySource(Protocol):
    """An array that is read by rows of its first axis."""

    @property
    def shape(self) -> tuple[int, ...]: ...

    @property
    def dtype(self) -> np.dtype[Any]: ...

    @property
    def on_disk(self) -> bool:
        """Whether only what is read comes into memory."""
        ...

    def read(self, rows: Rows) -> NDArray[Any]:
        """A copy of these rows."""
        ...


def read_whole(array: ArraySource) -> NDArray[Any]:
    """All of an array that is known to be small."""
    return array.read(slice(None) if array.shape else ())


@dataclass(frozen=True)
class HeldArray:
    """An array in memory."""

    values: NDArray[Any]

    @property
    def shape(self) -> tuple[int, ...]:
        return self.values.shape

    @property
    def dtype(self) -> np.dtype[Any]:
        return self.values.dtype

    @property
    def on_disk(self) -> bool:
        return False

    def read(self, rows: Rows) -> NDArray[Any]:
        return np.array(self.values[rows])


@dataclass(frozen=True)
class MappedArray:
    """Numbers that lie one after another in a file, from `offset` bytes on."""

    file: Path
    offset: int
    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    fortran_order: bool = False
    keeps: object = None  # what must live as long as the file is read

    @property
    def on_disk(self) -> bool:
        return True

    def read(self, rows: Rows) -> NDArray[Any]:
        if 0 in self.shape:  # nothing can be mapped of it
            return np.empty(self.shape, self.dtype)[rows]
        order = "F" if self.fortran_order else "C"
        mapped = np.memmap(self.file, self.dtype, "r", self.offset, self.shape, order)
        return np.array(mapped[rows])

    def __reduce__(self) -> tuple[Any, ...]:
        # A copy in another process reads the file, and leaves its removal to this one.
        parts = self.file, self.offset, self.dtype, self.shape, self.fortran_order
        return MappedArray, parts


@dataclass(frozen=True)
class H5Array:
    """A dataset of an HDF5 file, which is opened for each read."""

    file: Path
    key: str
    dtype: np.dtype[Any]
    shape: tuple[int, ...]

    @property
    def on_disk(self) -> bool:
        return True

    def read(self, rows: Rows) -> NDArray[Any]:
        import h5py

        with h5py.File(self.file, "r") as opened:
            found: Any = opened[self.key]
            if not isinstance(rows, np.ndarray):
                return np.asarray(found[rows])
            # HDF5 takes indices in rising order, each once.
            order, back = np.unique(rows, return_inverse=True)
            return found[order][back]


class TemporaryArrayFile:
    """A file of this process that is removed when nothing refers to it any more."""

    def __init__(self, stream: IO[bytes]) -> None:
        """Holds what `stream` gives, in the folder that TMPDIR names."""
        number, name = tempfile.mkstemp(prefix="anchorflow-", suffix=".npy")
        self.path = Path(name)
        weakref.finalize(self, _remove, self.path, os.getpid())
        with os.fdopen(number, "wb") as file:
            shutil.copyfileobj(stream, file, 1 << 20)


def _remove(path: Path, owner: int) -> None:
    if os.getpid() == owner:  # a forked worker shares the file, not the duty
        path.unlink(missing_ok=True)
