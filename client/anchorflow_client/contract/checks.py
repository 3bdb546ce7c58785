"""Checks of values that come from outside.

Each check returns the value in the type that the contract works with, or raises `InvalidRequest`
with the field's JSON path, what was expected and what came.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from difflib import get_close_matches
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from anchorflow_client.contract.ranges import MAX_TEXT_LENGTH, Interval
from anchorflow_client.errors import InvalidRequest

# Made once: `int | float` makes a new type whenever it is passed.
_NUMBERS = (int, float, np.integer, np.floating)
_WHOLE_NUMBERS = (int, np.integer)
_OBJECTS = (dict, Mapping)
"""A dict first: to ask an abstract class takes ten times as long."""


def describe(value: Any) -> str:
    """What came, in the words of JSON and short enough for a message."""
    match value:
        case None:
            return "null"
        case bool():
            return f"the boolean {str(value).lower()}"
        case str():
            return f"the string {value[:40]!r}" + ("…" if len(value) > 40 else "")
        case int() if value.bit_length() > 64:
            return f"an integer of {value.bit_length()} bits"
        case int() | np.integer():
            return str(int(value))
        case float() | np.floating():
            return str(float(value))
        case Mapping():
            return "an object"
        case list() | tuple():
            return f"a list of {len(value)}"
        case np.ndarray():
            return f"an array of {value.dtype} and shape {list(value.shape)}"
        case _:
            return f"a {type(value).__name__}"


def expected(field: str, what: str, value: Any) -> InvalidRequest:
    """The refusal that says what was expected in `field` and what came."""
    return InvalidRequest(f"expected {what}, got {describe(value)}", field)


def is_number(value: Any) -> bool:
    """Whether it is a JSON number; a boolean is none, although Python counts it as an int."""
    return is_number_type(type(value))


def is_number_type(kind: type) -> bool:
    """The same of a type."""
    return issubclass(kind, _NUMBERS) and not issubclass(kind, bool)


def as_array(value: Any, field: str, dtype: DTypeLike | None = None) -> NDArray[Any]:
    """What numpy makes of what a Python caller holds; numbers beyond `dtype` become infinite."""
    try:
        with np.errstate(over="ignore"):
            return np.asarray(value, dtype)
    except (TypeError, ValueError, OverflowError, RuntimeError) as error:  # of other libraries too
        raise InvalidRequest(f"expected an array of numbers, got none: {error}", field) from error


def number(value: Any, field: str, interval: Interval) -> float:
    """A finite number inside `interval`."""
    if not is_number(value) or not interval.holds(value):
        raise expected(field, f"a number {interval}", value)
    return float(value)


def integer(value: Any, field: str, interval: Interval) -> int:
    """A whole number inside `interval`, written without a fraction."""
    whole = isinstance(value, _WHOLE_NUMBERS) and not isinstance(value, bool)
    # Python's own comparison: numpy would round the ends of a 63-bit interval to float64.
    if not whole or not interval.low <= value <= interval.high:
        raise expected(field, f"an integer from {interval.low} to {interval.high}", value)
    return int(value)


def boolean(value: Any, field: str) -> bool:
    """true or false, and nothing that merely behaves like it."""
    if not isinstance(value, bool | np.bool_):
        raise expected(field, "true or false", value)
    return bool(value)


def text(value: Any, field: str) -> str:
    """A short string of printable ASCII, which every header can carry."""
    if not isinstance(value, str):
        raise expected(field, "a string", value)
    if not 1 <= len(value) <= MAX_TEXT_LENGTH or not (value.isascii() and value.isprintable()):
        raise expected(field, f"1 to {MAX_TEXT_LENGTH} printable ASCII characters", value)
    return value


def choice(value: Any, field: str, options: Collection[str]) -> str:
    """One of the strings in `options`."""
    if not isinstance(value, str) or value not in options:
        raise expected(field, "one of " + ", ".join(options), value)
    return value


def fields_of(
    value: Any, path: str, known: Collection[str], required: Collection[str] = ()
) -> Mapping[str, Any]:
    """A JSON object with all `required` fields and no field outside `known`.

    `path` is the object's own JSON path, empty for the body.
    """
    if not isinstance(value, _OBJECTS):
        raise expected(path or "body", "an object", value)
    prefix = f"{path}." if path else ""
    for name in value:
        if name not in known:
            stranger = _sendable(str(name))
            raise InvalidRequest(
                f"unknown field{_did_you_mean(stranger, known)}", prefix + stranger
            )
    for name in required:
        if value.get(name) is None:
            raise InvalidRequest("this field is required", prefix + name)
    return value


def _sendable(name: str) -> str:
    """Short, seen even if empty, and without lone surrogates, which JSON smuggles in and UTF-8
    cannot carry.
    """
    return name[:MAX_TEXT_LENGTH].encode("utf-8", "backslashreplace").decode() or '""'


def _did_you_mean(name: str, known: Collection[str]) -> str:
    close = get_close_matches(name, known, n=1)
    return f"; did you mean {close[0]!r}?" if close else "; known are " + ", ".join(known)
