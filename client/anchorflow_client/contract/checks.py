"""Checks of untrusted values: intervals, scalars, objects and arrays of numbers.

Each check returns the value in the type that the contract works with, or raises `InvalidRequest`
with the field's JSON path, what was expected and what came.

numpy alone does not check nested lists well enough: it reads `true` as 1.0, and pads a million
numbers beside one long string to that string's length. So lists are flattened level by level, at C
speed, and their types are checked first.
"""

from __future__ import annotations

import base64
import binascii
import math
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import chain
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from anchorflow_client.contract.hints import states_hint, unit_hint
from anchorflow_client.errors import InvalidRequest

MAX_TEXT_LENGTH = 128
MAX_DIMENSIONS = 4
"""Axes of an array of numbers given as nested lists."""
MAX_AXES = 8
"""Axes of a tensor given as bytes, B included."""
SCALAR_COMPARISONS = 16
"""Python compares up to this many numbers faster than numpy."""
DTYPES = {
    name: np.dtype(name).newbyteorder("<")
    for name in ("bool", "uint8", "int64", "float32", "float64")
}
"""The types that a tensor may have on the wire, little-endian; texts are sent too."""

Array = TypeVar("Array", bound=NDArray[Any])

# Made once: `int | float` makes a new type at every call.
_NUMBERS = (int, float, np.integer, np.floating)
_WHOLE_NUMBERS = (int, np.integer)
_OBJECTS = (dict, Mapping)
"""dict first: an abstract class takes ten times as long to check."""
_SEQUENCES = (list, tuple, np.ndarray)


@dataclass(frozen=True)
class Interval:
    """Numbers from `low` to `high` in `unit`; both ends belong to it unless they are open."""

    low: float
    high: float
    unit: str = ""
    open_low: bool = False
    open_high: bool = False

    def contains(self, values: ArrayLike) -> NDArray[np.bool_]:
        """Return element by element whether it is inside; NaN is in no interval."""
        values = np.asarray(values)
        above = values > self.low if self.open_low else values >= self.low
        below = values < self.high if self.open_high else values <= self.high
        return above & below

    def holds(self, number: float) -> bool:
        above = number > self.low if self.open_low else number >= self.low
        below = number < self.high if self.open_high else number <= self.high
        return bool(above and below)

    def holds_all(self, values: NDArray[Any]) -> bool:
        if values.size <= SCALAR_COMPARISONS:
            inside = all(map(self.holds, values.ravel().tolist()))
        else:  # the minimum and maximum of an array with a NaN are NaN
            inside = self.holds(values.min()) and self.holds(values.max())
        # `contains` compares in the array's own type, in which 1.1 equals an end of 1.1.
        return inside or bool(self.contains(values).all())

    def __str__(self) -> str:
        left, right = "(" if self.open_low else "[", ")" if self.open_high else "]"
        return f"in {left}{self.low:g}, {self.high:g}{right} {self.unit}".rstrip()


EVERY_NUMBER = Interval(-math.inf, math.inf)
_SIZE = Interval(1, 2**31)


def describe(value: Any) -> str:
    """Return a short description of a value in JSON's words, for a message."""
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
    """Return the error that says what was expected in `field` and what came."""
    return InvalidRequest(f"expected {what}, got {describe(value)}", field)


def is_number(value: Any) -> bool:
    """Return whether it is a JSON number; a boolean is not, although it is an int in Python."""
    return is_number_type(type(value))


def is_number_type(kind: type) -> bool:
    return issubclass(kind, _NUMBERS) and not issubclass(kind, bool)


def as_array(value: Any, field: str, dtype: DTypeLike | None = None) -> NDArray[Any]:
    """Convert a Python caller's value with numpy; numbers beyond `dtype` become infinite."""
    try:
        with np.errstate(over="ignore"):
            return np.asarray(value, dtype)
    except (
        TypeError,
        ValueError,
        OverflowError,
        RuntimeError,
    ) as error:  # other libraries raise these
        raise InvalidRequest(f"expected an array of numbers, got none: {error}", field) from error


def number(value: Any, field: str, interval: Interval) -> float:
    """Return a finite number inside `interval`."""
    if not is_number(value) or not interval.holds(value):
        hint = unit_hint(value, interval.low, interval.high, interval.unit)
        raise InvalidRequest(f"expected a number {interval}, got {describe(value)}{hint}", field)
    return float(value)


def integer(value: Any, field: str, interval: Interval) -> int:
    """Return a whole number inside `interval`; 64.0 is refused."""
    whole = isinstance(value, _WHOLE_NUMBERS) and not isinstance(value, bool)
    # Python's own comparison: numpy would round the ends of a 63-bit interval to float64.
    if not whole or not interval.low <= value <= interval.high:
        raise expected(field, f"an integer from {interval.low} to {interval.high}", value)
    return int(value)


def boolean(value: Any, field: str) -> bool:
    """Return a boolean; 0 and 1 are refused."""
    if not isinstance(value, bool | np.bool_):
        raise expected(field, "true or false", value)
    return bool(value)


def text(value: Any, field: str) -> str:
    """Return a short string of printable ASCII, which every header can carry."""
    if not isinstance(value, str):
        raise expected(field, "a string", value)
    if not 1 <= len(value) <= MAX_TEXT_LENGTH or not (value.isascii() and value.isprintable()):
        raise expected(field, f"1 to {MAX_TEXT_LENGTH} printable ASCII characters", value)
    return value


def choice(value: Any, field: str, options: Collection[str]) -> str:
    if not isinstance(value, str) or value not in options:
        raise expected(field, "one of " + ", ".join(options), value)
    return value


def fields_of(
    value: Any, path: str, known: Collection[str], required: Collection[str] = ()
) -> Mapping[str, Any]:
    """Return a JSON object that has all `required` fields and no field outside `known`.

    path: of the object itself, empty for the body
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
    """Shorten a name for a message; JSON may hold lone surrogates, which UTF-8 cannot encode."""
    return name[:MAX_TEXT_LENGTH].encode("utf-8", "backslashreplace").decode() or '""'


def _did_you_mean(name: str, known: Collection[str]) -> str:
    close = get_close_matches(name, known, n=1)
    return f"; did you mean {close[0]!r}?" if close else "; known are " + ", ".join(known)


def numbers(
    value: Any,
    field: str,
    interval: Interval,
    shape: str,
    *,
    hint: Callable[[NDArray[Any]], str] = lambda _: "",
) -> NDArray[np.float64]:
    """Return a new float64 array of finite numbers inside `interval`. Raises `InvalidRequest`.

    Args:
        value: nested lists, {"dtype", "shape", "base64"}, or what numpy converts to an array.
        field: JSON path for the message.
        interval: the range of each number.
        shape: the shapes that the caller accepts, for the message.
        hint: returns the end of the message about a number outside the interval.
    """
    if isinstance(value, dict):
        value = array_of_bytes(value, field)
    if hasattr(value, "__array__"):
        array = _from_array(value, field, shape)
    else:
        array = _from_lists(value, field, shape)
    return within(array, field, interval, hint=hint)


def array_of_bytes(value: Mapping[str, Any], field: str) -> NDArray[Any]:
    """Decode {"dtype", "shape", "base64"} to a read-only array. Raises `InvalidRequest`."""
    names = ("dtype", "shape", "base64")
    fields_of(value, field, names, names)
    dtype = DTYPES[choice(value["dtype"], f"{field}.dtype", DTYPES)]
    shape = value["shape"]
    if not isinstance(shape, list | tuple) or len(shape) > MAX_AXES:
        raise expected(f"{field}.shape", f"a list of at most {MAX_AXES} sizes", shape)
    for size in shape:
        integer(size, f"{field}.shape", _SIZE)
    data = bytes_of_base64(value["base64"], f"{field}.base64")
    if len(data) != (wanted := math.prod(shape) * dtype.itemsize):
        what = f"{wanted} bytes for {value['dtype']} {list(shape)}"
        raise InvalidRequest(f"expected {what}, got {len(data)}", f"{field}.base64")
    if dtype == np.bool_:  # any byte but 0 is true
        return read_only((np.frombuffer(data, np.uint8) != 0).reshape(shape))
    return read_only(np.frombuffer(data, dtype).reshape(shape))


def bytes_of_base64(value: Any, field: str) -> bytes:
    """Decode base64. Raises `InvalidRequest`."""
    if not isinstance(value, str):
        raise expected(field, "a string of base64", value)
    try:
        return base64.b64decode(value, validate=True)
    except (binascii.Error, ValueError) as error:
        raise InvalidRequest(f"expected base64, got {error}", field) from error


def within(
    array: Array,
    field: str,
    interval: Interval,
    *,
    part: slice | None = None,
    hint: Callable[[NDArray[Any]], str] = lambda _: "",
) -> Array:
    """Return the array. Raises `InvalidRequest` for the first number outside the interval.

    part: the columns to check; None for all
    hint: returns the end of the message
    """
    held = array if part is None else array[..., part]
    if interval.holds_all(held):
        return array
    outside = np.zeros(array.shape, np.bool_)
    outside[... if part is None else (..., part)] = ~interval.contains(held)
    is_finite = np.isfinite(array[outside][0])
    what = f"numbers {interval}" if is_finite else "finite numbers"
    raise first_refused(array, outside, field, what, hint(array))


def first_refused(
    array: NDArray[Any], refused: NDArray[np.bool_], field: str, what: str, hint: str = ""
) -> InvalidRequest:
    """Return the error for the first of an array's numbers that is `refused`.

    hint: the end of the message
    """
    index = int(refused.argmax())
    came = f"{describe(array.flat[index])} at {field}{_place(index, array.shape)}"
    return InvalidRequest(f"expected {what}, got {came}{hint}", field)


def vectors(value: Any, field: str, interval: Interval, *sizes: int) -> NDArray[np.float64]:
    """Return one vector [size] or a batch of them [B,size], of one of the sizes."""
    shape = ", ".join(map(vector_shape, sizes))
    array = numbers(value, field, interval, shape)
    if array.ndim not in (1, 2) or array.shape[-1] not in sizes:
        size = array.shape[-1] if array.ndim else 0
        raise wrong_shape(field, shape, array, states_hint(field, size))
    return array


def vector_shape(size: int) -> str:
    """Return the shapes that a field of vectors may have, for a message."""
    return f"[{size}] or [B,{size}]"


def wrong_shape(field: str, shape: str, array: NDArray[Any], hint: str = "") -> InvalidRequest:
    """Return the error for an array of a wrong shape; hint: the end of the message."""
    return InvalidRequest(f"expected shape {shape}, got {list(array.shape)}{hint}", field)


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Return the array, or a read-only view of it if it is writable."""
    if not array.flags.writeable:
        return array
    view = array.view()
    view.flags.writeable = False
    return view


def frozen(array: Array) -> Array:
    array.flags.writeable = False
    return array


def unshared(array: NDArray[Any]) -> NDArray[Any]:
    """Return the array if its memory cannot change, else a read-only copy."""
    return array if _is_constant(array) else frozen(array.copy())


def _is_constant(memory: Any) -> bool:
    """Return whether memory cannot change; a read-only view may be of a writable array."""
    match memory:
        case np.ndarray():
            return not memory.flags.writeable and _is_constant(memory.base)
        case memoryview():
            return _is_constant(memory.obj)
        case _:
            return memory is None or isinstance(memory, bytes)


def _from_array(value: Any, field: str, shape: str) -> NDArray[np.float64]:
    array = value if type(value) is np.ndarray else as_array(value, field)
    if array.dtype.kind not in "iuf":
        raise expected(field, f"numbers of shape {shape}", array)
    return array.astype(np.float64)


def _from_lists(value: Any, field: str, shape: str) -> NDArray[np.float64]:
    if not isinstance(value, list | tuple):
        raise expected(field, f"a list of numbers of shape {shape}", value)
    sizes, items = [len(value)], list(value)
    while items and isinstance(items[0], _SEQUENCES):
        sizes.append(_common_length(items, sizes, field, shape))
        items = list(chain.from_iterable(items))
    kinds = _check_leaves(items, sizes, field)
    if kinds == {int}:  # most maps: bytes are read in a fifth of the time
        with suppress(ValueError):
            return np.frombuffer(bytes(items), np.uint8).astype(np.float64).reshape(sizes)
    try:
        return np.array(items, dtype=np.float64).reshape(sizes)
    except OverflowError as error:
        raise InvalidRequest("expected finite numbers, got one beyond float64", field) from error


def _common_length(items: list[Any], sizes: list[int], field: str, shape: str) -> int:
    """Return the length of all lists of one level. Raises `InvalidRequest` if they differ."""
    if len(sizes) == MAX_DIMENSIONS:
        raise InvalidRequest(f"expected shape {shape}, got deeper lists", field)
    if not all(issubclass(kind, _SEQUENCES) for kind in set(map(type, items))):
        stranger = next(i for i, item in enumerate(items) if not isinstance(item, _SEQUENCES))
        raise _item_refused(items, stranger, sizes, field, "a list")
    lengths = list(map(len, items))
    if len(set(lengths)) > 1:
        odd = next(i for i, length in enumerate(lengths) if length != lengths[0])
        raise _item_refused(items, odd, sizes, field, f"a list of {lengths[0]} like the first")
    return lengths[0]


def _check_leaves(items: list[Any], sizes: list[int], field: str) -> set[type]:
    """Return the types of the items. Raises `InvalidRequest` if one is no number."""
    kinds = set(map(type, items))
    strangers = {kind for kind in kinds if not is_number_type(kind)}
    if strangers:
        index = next(i for i, item in enumerate(items) if type(item) in strangers)
        raise _item_refused(items, index, sizes, field, "a number")
    return kinds


def _item_refused(
    items: list[Any], index: int, sizes: list[int], field: str, what: str
) -> InvalidRequest:
    place = _place(index, tuple(sizes))
    return InvalidRequest(f"expected {what} at {field}{place}, got {describe(items[index])}", field)


def _place(flat_index: int, sizes: tuple[int, ...]) -> str:
    return "".join(f"[{i}]" for i in np.unravel_index(flat_index, sizes))
