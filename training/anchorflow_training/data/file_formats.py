"""Files of named arrays: .npy, .npz, .h5, .pt, and .pkl on request."""

from __future__ import annotations

import math
import os
import pickle
import re
import shutil
import struct
import tempfile
import weakref
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from anchorflow_client.errors import how_to_install
from anchorflow_driving.errors import UNREADABLE
from anchorflow_training.dataset import DatasetError

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


Arrays = dict[str, ArraySource]

LOCAL_HEADER = struct.Struct("<26xHH")  # of a zip member, up to the lengths of its name and extra


def open_arrays(path: Path, *, allow_pickle: bool = False) -> Arrays:
    """The arrays of a file by name; an array without a name is "positions".

    Raises `DatasetError`, naming the file, if it is missing, broken or of another kind, or a pickle
    that was not explicitly allowed.
    """
    openers: dict[str, Callable[[Path], Arrays]] = {
        ".npy": _open_npy,
        ".npz": _open_npz,
        ".h5": _open_h5,
        ".hdf5": _open_h5,
        ".pt": _open_torch,
        ".pth": _open_torch,
    }
    if not path.exists():
        raise DatasetError(f"{path}: there is no such file")
    suffix = path.suffix.lower()
    if suffix in (".pkl", ".pickle"):
        if not allow_pickle:
            raise DatasetError(
                f"{path}: a pickle runs whatever code its author put into it, so it is opened only "
                "with --allow-pickle (allow_pickle=True in Python), for a file of your own; "
                "numpy.savez writes the same arrays as a file that is safe to open"
            )
        openers[suffix] = _open_pickle
    if suffix not in openers:
        raise DatasetError(
            f"{path}: expected .npz, .npy, .h5, .pt or .pkl, found {suffix or 'no'} suffix"
        )
    try:
        return openers[suffix](path)
    except OSError as error:
        raise DatasetError(f"{path}: {error}") from error


def _open_npy(path: Path) -> Arrays:
    with path.open("rb") as stream:
        return {"positions": _mapped(path, stream, f"{path}")}


def _open_npz(path: Path) -> Arrays:
    arrays: Arrays = {}
    try:
        with zipfile.ZipFile(path) as archive, path.open("rb") as stream:
            for member in archive.infolist():
                name, where = member.filename.removesuffix(".npy"), f"{path}: {member.filename}"
                if member.compress_type != zipfile.ZIP_STORED or member.flag_bits & 1:
                    # Compressed bytes have no rows to map: unpack them, in pieces, into a file.
                    with archive.open(member) as packed:
                        unpacked = TemporaryArrayFile(packed)
                    with unpacked.path.open("rb") as plain:
                        arrays[name] = _mapped(unpacked.path, plain, where, keeps=unpacked)
                else:
                    stream.seek(member.header_offset)
                    lengths = LOCAL_HEADER.unpack(stream.read(LOCAL_HEADER.size))
                    stream.seek(sum(lengths), 1)
                    arrays[name] = _mapped(path, stream, where)
    except OSError:
        raise
    except (*UNREADABLE, struct.error) as error:
        raise DatasetError(f"{path}: not an .npz file ({error})") from error
    return arrays


def _mapped(file: Path, stream: IO[bytes], where: str, keeps: object = None) -> MappedArray:
    """The array whose .npy header begins where the stream stands."""
    try:
        version = np.lib.format.read_magic(stream)
        if version == (1, 0):
            shape, fortran_order, dtype = np.lib.format.read_array_header_1_0(stream)
        else:
            shape, fortran_order, dtype = np.lib.format.read_array_header_2_0(stream)
    except UNREADABLE as error:
        raise DatasetError(f"{where}: not an array that numpy wrote ({error})") from error
    if dtype.hasobject:
        raise DatasetError(
            f"{where}: expected numbers, found Python objects, which are a pickle; "
            "trajectories of one length make one array [N, T, D]"
        )
    array = MappedArray(file, stream.tell(), dtype, shape, fortran_order, keeps)
    size = math.prod(shape) * dtype.itemsize
    if file.stat().st_size < array.offset + size:
        raise DatasetError(f"{where}: cut off, {dtype} {list(shape)} needs {size} bytes")
    return array


def _open_h5(path: Path) -> Arrays:
    try:
        import h5py
    except ModuleNotFoundError as error:
        raise DatasetError(
            f"{path}: needs h5py, which is not installed: {how_to_install('train')}"
        ) from error
    with h5py.File(path, "r") as opened:
        arrays: Arrays = {
            name: HeldArray(np.asarray(value)) for name, value in opened.attrs.items()
        }
        for name, found in opened.items():
            if isinstance(found, h5py.Dataset) and found.shape is not None:
                arrays[name] = H5Array(path, name, found.dtype, found.shape)
    return arrays


def _open_torch(path: Path) -> Arrays:
    try:
        found: Any = torch.load(path, map_location="cpu", weights_only=True)
    except OSError:
        raise
    except Exception as error:
        # torch's message explains how to run the file's code, which is unsafe.
        held = re.search(r"GLOBAL ([\w.]+)", str(error))
        found_instead = f", found {held[1]}" if held else ", found another file or a broken one"
        raise DatasetError(
            f"{path}: expected a dict of tensors and numbers that torch.save wrote{found_instead}"
        ) from error
    return _held(path, found)


def _open_pickle(path: Path) -> Arrays:
    try:
        with path.open("rb") as stream:
            found: Any = pickle.load(stream)
    except Exception as error:
        raise DatasetError(f"{path}: cannot be unpickled ({error!r})") from error
    return _held(path, found)


def _held(path: Path, found: Any) -> Arrays:
    """Return the arrays of a loaded object: a dict of arrays, or the positions alone."""
    named = found if isinstance(found, dict) else {"positions": found}
    return {str(name): HeldArray(_one_array(path, name, value)) for name, value in named.items()}


def _one_array(path: Path, name: str, value: Any) -> NDArray[Any]:
    try:
        if isinstance(value, Tensor):
            value = value.detach().cpu()
            # numpy has no bfloat16.
            return (value.float() if value.dtype == torch.bfloat16 else value).numpy()
        return np.asarray(value)
    except (TypeError, ValueError) as error:
        raise DatasetError(f"{path}: {name}: not one array ({error})") from error
