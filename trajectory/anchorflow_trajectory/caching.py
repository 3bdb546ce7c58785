"""Caches: attributes computed on first use, and fields shared by requests on the same map."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from threading import Lock
from typing import Any, Generic, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import BoolArray

Field = NDArray[np.float32]
Key = tuple[bytes, tuple[int, ...], float]


class MapCache:
    """A least-recently-used cache of fields by the content of their map; thread-safe.

    most_bytes: of the fields and the keys, which take an eighth of a byte a cell
    """

    def __init__(self, *, most_bytes: int) -> None:
        self._most_bytes = most_bytes
        self._fields = OrderedDict[Key, Field]()
        self._bytes = 0
        self._lock = Lock()

    def of(
        self,
        occupied: BoolArray,
        resolution: float,
        work_out: Callable[[BoolArray, float], Field],
    ) -> Field:
        """Return the field of a map [H, W] at `resolution` m/cell, read-only."""
        key = (np.packbits(occupied).tobytes(), occupied.shape, float(resolution))
        with self._lock:
            field = self._fields.get(key)
            if field is not None:
                self._fields.move_to_end(key)
                return field
        # Outside the lock: two threads may compute the same field at once.
        field = work_out(occupied, resolution)
        field.setflags(write=False)
        with self._lock:
            if key not in self._fields:
                self._fields[key] = field
                self._bytes += _size(key, field)
            while self._bytes > self._most_bytes:
                self._bytes -= _size(*self._fields.popitem(last=False))
        return field

    def __len__(self) -> int:
        return len(self._fields)


def _size(key: Key, field: Field) -> int:
    return len(key[0]) + field.nbytes


Value = TypeVar("Value")


class cached_property(Generic[Value]):  # noqa: N801 - named as in functools
    """`functools.cached_property` without a lock, as from Python 3.12 on.

    The older one holds one lock for all instances, so that threads on different scenes would wait
    for each other. Threads may compute the value of one instance more than once.
    """

    def __init__(self, work_out: Callable[[Any], Value]) -> None:
        self._work_out = work_out
        self.__doc__ = work_out.__doc__

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    @overload
    def __get__(self, instance: None, owner: type) -> cached_property[Value]: ...
    @overload
    def __get__(self, instance: object, owner: type) -> Value: ...
    def __get__(self, instance: object | None, owner: type) -> Value | cached_property[Value]:
        if instance is None:
            return self
        # The instance's attribute now hides this descriptor, which has no __set__.
        value = instance.__dict__[self._name] = self._work_out(instance)
        return value
