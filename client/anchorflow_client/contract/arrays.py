"""Arrays of numbers out of untrusted nested lists.

numpy alone will not do: it takes `true` for 1.0, and pads a million numbers beside one long string
to that string's length. So the lists are flattened level by level, at C speed, and looked at first.
"""

from __future__ import annotations

from itertools import chain
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract.checks import as_array, describe, expected, is_number_type
from anchorflow_client.contract.ranges import Interval
from anchorflow_client.errors import InvalidRequest

MAX_DIMENSIONS = 4

Array = TypeVar("Array", bound=NDArray[Any])

_SEQUENCES = (list, tuple, np.ndarray)


def numbers(value: Any, field: str, interval: Interval, shape: str) -> NDArray[np.float64]:
    """A new float64 array of finite numbers inside `interval`.

    Args:
        value: nested lists, or anything that numpy takes for an array of numbers.
        field: JSON path for the message.
        interval: what each number may be.
        shape: the shapes that the caller will accept, for the message.

    Raises:
        InvalidRequest: ragged, too deep, not numbers, not finite or out of range.
    """
    array = _from_array(value, field, shape) if hasattr(value, "__array__") else None
    if array is None:
        array = _from_lists(value, field, shape)
    return within(array, field, interval)


def within(array: Array, field: str, interval: Interval, *, part: slice | None = None) -> Array:
    """The array itself. Raises `InvalidRequest` for the first number outside the interval.

    part: the columns that are held against it; None: all numbers
    """
    held = array if part is None else array[..., part]
    if interval.holds_all(held):
        return array
    outside = np.zeros(array.shape, np.bool_)
    outside[... if part is None else (..., part)] = ~interval.contains(held)
    is_finite = np.isfinite(array[outside][0])
    what = f"numbers {interval}" if is_finite else "finite numbers"
    raise first_refused(array, outside, field, what)


def first_refused(
    array: NDArray[Any], refused: NDArray[np.bool_], field: str, what: str
) -> InvalidRequest:
    """The refusal of the first of an array's numbers that is `refused`, with its place."""
    index = int(refused.argmax())
    came = f"{describe(array.flat[index])} at {field}{_place(index, array.shape)}"
    return InvalidRequest(f"expected {what}, got {came}", field)


def vectors(value: Any, field: str, interval: Interval, *sizes: int) -> NDArray[np.float64]:
    """One vector [size] or a batch of them [B,size], of one of the sizes."""
    shape = ", ".join(map(vector_shape, sizes))
    array = numbers(value, field, interval, shape)
    if array.ndim not in (1, 2) or array.shape[-1] not in sizes:
        raise wrong_shape(field, shape, array)
    return array


def vector_shape(size: int) -> str:
    """The shapes that a field of vectors may have, for a message."""
    return f"[{size}] or [B,{size}]"


def wrong_shape(field: str, shape: str, array: NDArray[Any]) -> InvalidRequest:
    """The refusal of an array by its shape."""
    return InvalidRequest(f"expected shape {shape}, got {list(array.shape)}", field)


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """The array where it cannot be written through, else such a view of it."""
    if not array.flags.writeable:
        return array
    view = array.view()
    view.flags.writeable = False
    return view


def frozen(array: Array) -> Array:
    """The array itself, to which nobody writes any more."""
    array.flags.writeable = False
    return array


def unshared(array: NDArray[Any]) -> NDArray[Any]:
    """The array itself where nobody can write to its memory, else a copy that nobody can."""
    return array if _is_constant(array) else frozen(array.copy())


def _is_constant(memory: Any) -> bool:
    """Whether nobody can write to it: a read-only view may be one of an array that changes."""
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
    _check_leaves(items, sizes, field)
    try:
        return np.array(items, dtype=np.float64).reshape(sizes)
    except OverflowError as error:
        raise InvalidRequest("expected finite numbers, got one beyond float64", field) from error


def _common_length(items: list[Any], sizes: list[int], field: str, shape: str) -> int:
    """The length that all lists of one level share."""
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


def _check_leaves(items: list[Any], sizes: list[int], field: str) -> None:
    strangers = {kind for kind in set(map(type, items)) if not is_number_type(kind)}
    if strangers:
        index = next(i for i, item in enumerate(items) if type(item) in strangers)
        raise _item_refused(items, index, sizes, field, "a number")


def _item_refused(
    items: list[Any], index: int, sizes: list[int], field: str, what: str
) -> InvalidRequest:
    place = _place(index, tuple(sizes))
    return InvalidRequest(f"expected {what} at {field}{place}, got {describe(items[index])}", field)


def _place(flat_index: int, sizes: tuple[int, ...]) -> str:
    return "".join(f"[{i}]" for i in np.unravel_index(flat_index, sizes))
