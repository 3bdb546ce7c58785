"""Named inputs: what planners without a cost map are asked with, as tensors, images and texts.

A request carries them as they came; they are held against the card once it is known, in `bind`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract.checks import (
    DTYPES,
    EVERY_NUMBER,
    Interval,
    array_of_bytes,
    bytes_of_base64,
    choice,
    describe,
    expected,
    fields_of,
    first_refused,
    integer,
    numbers,
    read_only,
    text,
    unshared,
    within,
)
from anchorflow_client.contract.fields import MAX_INPUT_TEXT_LENGTH, MAX_SCENES
from anchorflow_client.contract.kinds import TensorSpec
from anchorflow_client.errors import InvalidRequest

TEXT = "text"
IMAGE_FORMATS = ("png", "jpeg")
INT64 = Interval(-(2**63), 2**63 - 1)
EXACT = 2.0**53
"""From which on float64 does not hold every whole number."""


@dataclass(frozen=True)
class EncodedImage:
    """A picture as a camera or a file gives it; the service decodes it to uint8 [3,H,W], RGB."""

    format: str
    """"png" or "jpeg"."""
    data: bytes

    def __post_init__(self) -> None:
        """Raises `InvalidRequest` where the format is none of the two, or the data no bytes."""
        choice(self.format, "format", IMAGE_FORMATS)
        try:
            memoryview(self.data)
        except TypeError as error:
            raise expected("data", "bytes", self.data) from error


Input: TypeAlias = NDArray[Any] | EncodedImage
"""An array of numbers, an array of `str` objects, or a picture that is not decoded yet."""
Inputs: TypeAlias = Mapping[str, Input]


def read_inputs(value: Any) -> Inputs:
    """Inputs by name out of untrusted JSON, or out of what a Python caller holds.

    Args:
        value: by name: an array, nested lists of numbers, {"dtype", "shape", "base64"},
            {"png" or "jpeg": base64}, an `EncodedImage`, a string or a list of strings; None stands
            for one that is left out.

    Raises:
        InvalidRequest: names inputs.NAME.
    """
    if not isinstance(value, Mapping):
        raise expected("inputs", "an object of inputs by name", value)
    return {
        text(name, "inputs"): _filled(_read(name, each), f"inputs.{name}")
        for name, each in value.items()
        if each is not None
    }


def texts(values: Sequence[str], field: str, shape: Sequence[int]) -> NDArray[Any]:
    """An array of `str` objects. Raises `InvalidRequest` for one that is too long."""
    for value in values:
        if len(value) > MAX_INPUT_TEXT_LENGTH:
            most = f"a text of at most {MAX_INPUT_TEXT_LENGTH} characters"
            raise InvalidRequest(f"expected {most}, got {len(value)}", field)
        if not _encodable(value):
            raise InvalidRequest("expected text that UTF-8 can carry, got lone surrogates", field)
    array = np.empty(len(values), dtype=object)
    array[:] = values
    return read_only(array.reshape(shape))


def exact_numbers(value: Any, field: str, shape: str) -> NDArray[Any]:
    """Nested lists as float64; as int64 where all are whole and float64 would round one.

    shape: for the message

    Raises:
        InvalidRequest: as `numbers`.
    """
    array = numbers(value, field, EVERY_NUMBER, shape)
    if np.abs(array).max(initial=0.0) < EXACT:
        return array
    leaves = np.array(value, dtype=object).ravel().tolist()
    if not all(INT64.low <= leaf <= INT64.high and leaf == int(leaf) for leaf in leaves):
        return array
    return np.array([int(leaf) for leaf in leaves], np.int64).reshape(array.shape)


def bind(inputs: Inputs, specs: Sequence[TensorSpec]) -> tuple[Inputs, int, bool]:
    """Inputs held against a card: each [B,…] of its card's dtype, B, and whether one was batched.

    Raises:
        InvalidRequest: names inputs.NAME: it is missing and not optional, unknown, or of another
            dtype, shape or range than the card's.
    """
    needed = [spec.name for spec in specs if not spec.optional]
    fields_of(inputs, "inputs", [spec.name for spec in specs], needed)
    specs = [spec for spec in specs if spec.name in inputs]
    sizes: dict[str, tuple[int, str]] = {}
    bound: dict[str, NDArray[Any]] = {}
    for spec in specs:
        field = f"inputs.{spec.name}"
        array = _typed(inputs[spec.name], spec, field)
        bound[spec.name] = _in_range(_shaped(array, spec, field, sizes), spec, field)
    batched = "B" in sizes
    num_scenes = sizes["B"][0] if batched else 1
    if not 1 <= num_scenes <= MAX_SCENES:
        most = f"B from 1 to {MAX_SCENES}"
        raise InvalidRequest(f"expected {most}, got {num_scenes}", sizes["B"][1])
    return (
        {spec.name: _batched(bound[spec.name], spec, num_scenes) for spec in specs},
        num_scenes,
        batched,
    )


def _read(name: str, value: Any) -> Input:
    field = f"inputs.{name}"
    match value:
        case EncodedImage():
            return value
        case str():
            return texts([value], field, ())
        case np.ndarray() | np.generic():
            return _own_array(np.asarray(value), field)
        case list() | tuple() if value and all(isinstance(each, str) for each in value):
            return texts(list(value), field, (len(value),))
        case Mapping():
            return _read_object(value, field)
        case bool() | float():
            return read_only(np.asarray(value))
        case int():
            return read_only(np.asarray(integer(value, field, INT64)))
        case _:
            return read_only(exact_numbers(value, field, "numbers"))


def _filled(value: Input, field: str) -> Input:
    """The input itself; one without a number is refused, as on every wire."""
    if isinstance(value, np.ndarray) and not value.size:
        raise expected(field, "no axis of size 0", value)
    return value


def _own_array(array: NDArray[Any], field: str) -> NDArray[Any]:
    """A caller's array; where he could still write to it, a copy."""
    if array.dtype.kind in "UO":
        if not all(isinstance(each, str) for each in array.flat):
            raise expected(field, "numbers or texts", array)
        return texts([str(each) for each in array.flat], field, array.shape)
    if array.dtype.kind not in "biuf":
        raise expected(field, "numbers or texts", array)
    if array.dtype.newbyteorder("=").name not in DTYPES:
        return read_only(_widened(array, field))
    return read_only(unshared(array))


def _widened(array: NDArray[Any], field: str) -> NDArray[Any]:
    """Numbers of a type that the wire lacks in one that it has; nothing is lost of them."""
    if array.dtype.kind in "iu":
        wider = np.dtype(np.int64)
    else:
        wider = np.dtype(np.float32 if array.dtype.itemsize == 2 else np.float64)
    with np.errstate(all="ignore"):
        wide = array.astype(wider)
    if not np.array_equal(wide, array, equal_nan=True):
        raise expected(field, f"numbers that {wider} holds", array)
    return wide


def _read_object(value: Mapping[str, Any], field: str) -> Input:
    if len(value) == 1 and (image := next(iter(value))) in IMAGE_FORMATS:
        return EncodedImage(image, bytes_of_base64(value[image], f"{field}.{image}"))
    return array_of_bytes(value, field)


def _typed(value: Input, spec: TensorSpec, field: str) -> NDArray[Any]:
    """The input in its card's dtype; only what nothing is lost of is converted."""
    if isinstance(value, EncodedImage):
        raise expected(field, f"{spec.dtype}; no picture is decoded here", value)
    if spec.dtype == TEXT or value.dtype.kind == "O":
        if spec.dtype != TEXT or value.dtype.kind != "O":
            came = "text" if value.dtype.kind == "O" else describe(value)
            raise InvalidRequest(f"expected {spec.dtype}, got {came}", field)
        return value
    dtype = np.dtype(spec.dtype)
    if value.dtype == dtype:
        return value
    # Numbers written as JSON have no type of their own.
    if value.dtype.kind in "if" and value.dtype.itemsize == 8:
        with np.errstate(all="ignore"):
            cast = value.astype(dtype)
        if dtype.kind != "f" and (changed := cast != value).any():
            raise first_refused(value, changed, field, f"{dtype} numbers")
        if (beyond := np.isinf(cast) & np.isfinite(value)).any():
            raise first_refused(value, beyond, field, f"numbers that {dtype} holds")
        return cast
    raise expected(field, f"{spec.dtype} {_shape_of(spec)}", value)


def _shaped(
    array: NDArray[Any], spec: TensorSpec, field: str, sizes: dict[str, tuple[int, str]]
) -> NDArray[Any]:
    """The array, whose axes agree with the card's and with those seen before."""
    axes = spec.shape if array.ndim == len(spec.shape) else spec.shape[1:]
    if array.ndim != len(axes):
        raise expected(field, f"shape {_shape_of(spec)}", array)
    for axis, size in zip(axes, array.shape, strict=True):
        if isinstance(axis, int):
            if size != axis:
                raise expected(field, f"shape {_shape_of(spec)}", array)
        elif axis not in sizes:
            sizes[axis] = size, field
        elif sizes[axis][0] != size:
            known, first = sizes[axis]
            raise InvalidRequest(f"expected {axis} = {known} as in {first}, got {size}", field)
    return array


def _in_range(array: NDArray[Any], spec: TensorSpec, field: str) -> NDArray[Any]:
    if array.dtype.kind not in "iuf":
        return array
    low, high = spec.range or (None, None)
    least = -math.inf if low is None else low
    most = math.inf if high is None else high
    if array.dtype.kind == "f":  # finite, where the card says nothing else
        largest = float(np.finfo(array.dtype).max)
        least, most = max(least, -largest), min(most, largest)
    return within(array, field, Interval(least, most, spec.unit))


def _batched(array: NDArray[Any], spec: TensorSpec, num_scenes: int) -> NDArray[Any]:
    """[B,…]; an input without a B axis is the same in every scene."""
    if array.ndim < len(spec.shape):
        array = np.broadcast_to(array, (num_scenes, *array.shape))
    return read_only(array)


def _shape_of(spec: TensorSpec) -> str:
    one = ",".join(map(str, spec.shape[1:]))
    return f"[{one}] or [{spec.shape[0]},{one}]" if one else f"[] or [{spec.shape[0]}]"


def _encodable(value: str) -> bool:
    try:
        value.encode()
    except UnicodeEncodeError:
        return False
    return True
