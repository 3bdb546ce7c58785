"""Pickles of plain data: arrays, numbers, texts and containers. Nothing in them is run.

A pickle is a program that may call any global it names. Here it may name only the parts of numpy
arrays and sets, and gets a stand-in for each: even numpy's own constructors, which trust their
arguments, see no byte of the file before its size and type are checked.
"""

from __future__ import annotations

import math
import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.errors import LogError

_CODE = re.compile(r"b1|[iu][1248]|f[248]|c(8|16)|[SU]\d{1,6}|O8?")
_UNREADABLE = (
    pickle.UnpicklingError,
    ArithmeticError,
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    RecursionError,
    TypeError,
    ValueError,
)


def load_plain_pickle(path: Path) -> Any:
    """Load a file of containers, numbers, texts, and objects that `numpy.asarray` takes.

    Raises `LogError` if the file cannot be read, or names any other global, which is not called.
    """
    try:
        with path.open("rb") as stream:
            return _PlainUnpickler(stream, path).load()
    except _UNREADABLE as error:
        found = f"{type(error).__name__}: {error}"
        raise LogError(path, "file", expected="a pickle of plain data", found=found) from error


class _Type:
    """In the place of `numpy.dtype`."""

    code, order = "", "="

    def __init__(self, code: str, *_: object) -> None:
        if not _CODE.fullmatch(code):
            raise ValueError(f"an array of the type {code!r}")
        self.code = code

    def __setstate__(self, state: tuple) -> None:
        _, order, *parts = state[:5]
        if order not in ("<", ">", "|", "=") or any(part is not None for part in parts):
            raise ValueError("an array of records")
        self.order = order

    def array(self, raw: Any, shape: tuple[int, ...], order: str) -> NDArray:
        """Make an array from a buffer, or from a list if its elements are objects."""
        if self.code.startswith("O"):
            if not isinstance(raw, list) or len(raw) != math.prod(shape):
                raise ValueError("an array of objects without a list of them")
            flat = np.empty(len(raw), object)
            flat[:] = raw
        else:
            flat = np.zeros(0) if math.prod(shape) == 0 else np.frombuffer(raw, self._dtype())
            flat = flat.astype(self._dtype().newbyteorder("="))
        return flat.reshape(shape, order="F" if order == "F" else "C")

    def _dtype(self) -> np.dtype:
        return np.dtype(self.order.replace("|", "=") + self.code)


class _Array:
    """In the place of `numpy.ndarray`; `numpy.asarray` gives the array."""

    _array: NDArray = np.zeros(0)

    def __setstate__(self, state: tuple) -> None:
        _, shape, dtype, is_fortran, raw = state
        self._array = _checked(dtype).array(raw, shape, "F" if is_fortran else "C")

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray:
        return self._array if dtype is None else self._array.astype(dtype)


class _PlainUnpickler(pickle.Unpickler):
    def __init__(self, stream: Any, path: Path) -> None:
        super().__init__(stream)
        self._path = path
        # numpy 1 calls its core `numpy.core`, numpy 2 `numpy._core`. Bound methods, because a
        # pickle may set attributes of what it is given, and these take none.
        self._allowed = {
            "numpy.dtype": _Type,
            "numpy.ndarray": _Array,
            "numpy.core.multiarray._reconstruct": self._reconstruct,
            "numpy.core.multiarray.scalar": self._scalar,
            "numpy.core.numeric._frombuffer": self._from_buffer,
            "_codecs.encode": self._encode,
            "builtins.bytes": self._no_bytes,
            "builtins.set": set,
            "builtins.frozenset": frozenset,
        }

    def find_class(self, module: str, name: str) -> Any:
        asked = f"{module}.{name}"
        plain = asked.replace("numpy._core.", "numpy.core.").replace("__builtin__.", "builtins.")
        if plain not in self._allowed:
            expected = "arrays, numbers, texts and containers only"
            raise LogError(self._path, "pickle", expected=expected, found=f"the global {asked}")
        return self._allowed[plain]

    def _reconstruct(self, *_: object) -> _Array:
        return _Array()

    def _scalar(self, dtype: object, raw: Any) -> Any:
        return _checked(dtype).array(raw, (1,), "C")[0].item()

    def _from_buffer(
        self, raw: Any, dtype: object, shape: tuple, order: str, axes: tuple | None = None
    ) -> _Array:
        array = _Array()
        filled = _checked(dtype).array(raw, shape, order)
        array._array = filled if axes is None else filled.transpose(axes)
        return array

    def _no_bytes(self) -> bytes:
        """How protocols before 3 hold none."""
        return b""

    def _encode(self, text: str, *_: object) -> bytes:
        """How protocols before 3 hold bytes."""
        return text.encode("latin1")


def _checked(dtype: object) -> _Type:
    if not isinstance(dtype, _Type):
        raise TypeError(f"the type of an array is {type(dtype).__name__}")
    return dtype
