"""The kinds of rows in the table of request fields, one for each JSON type."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract.checks import (
    Interval,
    boolean,
    choice,
    describe,
    expected,
    fields_of,
    integer,
    number,
    numbers,
    read_only,
    text,
    wrong_shape,
)
from anchorflow_client.errors import InvalidRequest

EIGHT_STEP_SCHEDULE = (0.0, 0.8, 0.85, 0.9, 0.92, 0.94, 0.96, 0.98, 1.0)
"""Flow times of the schedule that a request may call "8step"."""
MAX_SCHEDULE_STEPS = 100
MIN_STEP = 1e-6
"""Least distance of two flow times: multistep methods divide by it, in float32."""
_STEPS = Interval(1, MAX_SCHEDULE_STEPS)

Value = TypeVar("Value")


@dataclass(frozen=True)
class Row:
    """The facts about one field; a subclass for each JSON type."""

    meaning: str
    """One line, without the unit, the range and the default."""
    default: Any = field(default=None, kw_only=True)
    """None: the model's card decides, or the field is left out."""
    required: bool = field(default=False, kw_only=True)

    def read(self, value: Any, path: str) -> Any:
        """Return the checked value. Raises `InvalidRequest` naming the JSON path."""
        raise NotImplementedError(f"{path} is read by the code that uses it")


@dataclass(frozen=True)
class Number(Row):
    """A float in `interval`, or with `whole` an int."""

    interval: Interval
    whole: bool = False

    def read(self, value: Any, path: str) -> float:
        check = integer if self.whole else number
        return check(value, path, self.interval)


@dataclass(frozen=True)
class Flag(Row):
    """A boolean."""

    def read(self, value: Any, path: str) -> bool:
        return boolean(value, path)


@dataclass(frozen=True)
class Text(Row):
    """Printable ASCII, or one of `options`."""

    options: tuple[str, ...] = ()

    def read(self, value: Any, path: str) -> str:
        return choice(value, path, self.options) if self.options else text(value, path)


@dataclass(frozen=True)
class Names(Row):
    """A list of texts."""

    def read(self, value: Any, path: str) -> tuple[str, ...]:
        """Return each name once."""
        if not isinstance(value, list | tuple):
            raise expected(path, "a list of names", value)
        return tuple(dict.fromkeys(text(name, path) for name in value))


@dataclass(frozen=True)
class Array(Row):
    """Numbers: nested lists, or {"dtype", "shape", "base64"}; read by the code that uses them."""

    shape: str
    """The axes in letters, for the reference."""
    sizes: tuple[tuple[int, int], ...]
    """Least and most entries along each axis but B."""
    interval: Interval
    unit: str = ""
    tensor: str = ""
    """The name in the binary form, if it is a tensor there."""
    batched: bool = False
    """A leading B is allowed."""
    words: tuple[str, ...] = ()
    """Names that may stand for an array."""
    objects: tuple[str, ...] = ()
    """Keys of objects that may stand for an array: "uniform", or over JSON "png"."""


@dataclass(frozen=True)
class FlowTimes(Array):
    """Increasing times from 0 to 1, "8step" or {"uniform": n}."""

    def read(self, value: Any, path: str) -> tuple[float, ...]:
        match value:
            case str():
                if value == "8step":
                    return EIGHT_STEP_SCHEDULE
            case {"uniform": steps} if len(value) == 1:
                return uniform_schedule(integer(steps, f"{path}.uniform", _STEPS))
            case {"base64": _} | list() | tuple() | np.ndarray():
                return _increasing(numbers(value, path, self.interval, self.shape), path)
            case dict():
                fields_of(value, path, ("uniform",), ("uniform",))
        raise expected(path, '"8step", {"uniform": n} or a list of flow times', value)


@dataclass(frozen=True)
class TimedPoses(Array):
    """Rows of time and pose, in the order of time."""

    def read(self, value: Any, path: str) -> NDArray[np.float64]:
        """Return the rows [K,4]."""
        rows = numbers(value, path, self.interval, self.shape)
        (least, most), (columns, _) = self.sizes
        if rows.ndim != 2 or not least <= len(rows) <= most or rows.shape[1] != columns:
            raise wrong_shape(path, f"{self.shape}, K from {least} to {most}", rows)
        if (np.diff(rows[:, 0]) <= 0).any():
            times = rows[:, 0].tolist()
            raise InvalidRequest(f"expected strictly increasing times, got {times}", path)
        return read_only(rows)


def uniform_schedule(steps: int) -> tuple[float, ...]:
    """Return the flow times of `steps` equal strides from 0 to 1."""
    return tuple(k / steps for k in range(steps + 1))


def _increasing(times: NDArray[np.float64], path: str) -> tuple[float, ...]:
    if times.ndim != 1 or not 2 <= times.size <= MAX_SCHEDULE_STEPS + 1:
        raise wrong_shape(path, f"[K], K from 2 to {MAX_SCHEDULE_STEPS + 1}", times)
    visited: list[float] = times.tolist()
    shortest = min(later - earlier for earlier, later in pairwise(visited))
    if shortest <= 0:
        raise InvalidRequest(f"expected strictly increasing times, got {visited}", path)
    if shortest < MIN_STEP:
        what = f"times at least {MIN_STEP:g} apart"
        raise InvalidRequest(f"expected {what}, got {visited}", path)
    if visited[-1] != 1.0:
        raise InvalidRequest(f"expected a last time of 1, got {describe(visited[-1])}", path)
    return tuple(visited)


@dataclass(frozen=True)
class Inputs(Row):
    """Tensors, pictures and texts by name."""


@dataclass(frozen=True)
class Group(Row):
    """An object of further fields."""

    fields: Mapping[str, Row]

    def read(self, value: Any, path: str, **readers: Callable[[Any, str], Any]) -> dict[str, Any]:
        """Return the checked fields of an object, without those that are null.

        readers: functions in place of a row's own `read`, by the name of the field
        """
        return {
            name: readers.get(name, self.fields[name].read)(each, f"{path}.{name}")
            for name, each in fields_of(value, path, self.fields, self.required_fields).items()
            if each is not None
        }

    @cached_property
    def required_fields(self) -> tuple[str, ...]:
        """The names of the fields that an object must have."""
        return tuple(name for name, row in self.fields.items() if row.required)


def rows_of(kind: type) -> dict[str, Row]:
    """Return the rows of a TypedDict, those it inherits first."""
    return {name: each.__metadata__[0] for name, each in kind.__annotations__.items()}


def tensor_paths(group: Group, prefix: str = "") -> dict[str, str]:
    """Return the JSON paths of the fields that are tensors in the binary form, by tensor."""
    paths: dict[str, str] = {}
    for name, row in group.fields.items():
        if isinstance(row, Group):
            paths |= tensor_paths(row, f"{prefix}{name}.")
        elif isinstance(row, Array) and row.tensor:
            paths[row.tensor] = prefix + name
    return paths


def with_rows(rows: Mapping[str, Row]) -> Callable[[type[Value]], type[Value]]:
    """Return a decorator that declares, on a class of fields, the rows that it does not spell out.

    Written below `@dataclass`; such fields default to None.
    """

    def declare(kind: type[Value]) -> type[Value]:
        for name in rows:
            if name not in kind.__annotations__ and not hasattr(kind, name):
                kind.__annotations__[name] = "Any"
                setattr(kind, name, None)
        return kind

    return declare
