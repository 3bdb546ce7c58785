"""Named inputs of planners without a cost map: tensors, pictures and texts.

A request carries them as received; `bind` checks them against the card of the model.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract.card import TensorSpec
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
from anchorflow_client.errors import InvalidRequest

TEXT = "text"
IMAGE_FORMATS = ("png", "jpeg")
INT64 = Interval(-(2**63), 2**63 - 1)
EXACT = 2.0**53
"""The first whole number beyond which float64 skips some."""


@dataclass(frozen=True)
class EncodedImage:
    """A picture file's bytes; the service decodes them to uint8 [3,H,W], RGB."""

    format: str
    """"png" or "jpeg"."""
    data: bytes

    def __post_init__(self) -> None:
        """Check the format and the data. Raises `InvalidRequest`."""
        choice(self.format, "format", IMAGE_FORMATS)
        try:
            memoryview(self.data)
        except TypeError as error:
            raise expected("data", "bytes", self.data) from error


Input: TypeAlias = NDArray[Any] | EncodedImage
"""An array of numbers, an array of `str` objects, or a picture that is not yet decoded."""
Inputs: TypeAlias = Mapping[str, Input]


def read_inputs(value: Any) -> Inputs:
    """Read inputs by name from untrusted JSON, or from a Python caller. Raises `InvalidRequest`.

    value: by name: an array, nested lists of numbers, {"dtype", "shape", "base64"},
        {"png" or "jpeg": base64}, an `EncodedImage`, a string or a list of strings; None leaves
        the input out
    """
    if not isinstance(value, Mapping):
        raise expected("inputs", "an object of inputs by name", value)
    read = {
        text(name, "inputs"): _read(name, each) for name, each in value.items() if each is not None
    }
    for name, each in read.items():
        if isinstance(each, np.ndarray) and not each.size:
            raise expected(f"inputs.{name}", "no axis of size 0", each)
    return read


def texts(values: Sequence[str], field: str, shape: Sequence[int]) -> NDArray[Any]:
    """Return an array of `str` objects. Raises `InvalidRequest` if one is too long."""
    for value in values:
        if len(value) > MAX_INPUT_TEXT_LENGTH:
            most = f"a text of at most {MAX_INPUT_TEXT_LENGTH} characters"
            raise InvalidRequest(f"expected {most}, got {len(value)}", field)
        try:
            value.encode()
        except UnicodeEncodeError as error:
            message = "expected text that UTF-8 can carry, got lone surrogates"
            raise InvalidRequest(message, field) from error
    array = np.empty(len(values), dtype=object)
    array[:] = values
    return read_only(array.reshape(shape))


def exact_numbers(value: Any, field: str, shape: str) -> NDArray[Any]:
    """Return nested lists as float64, or as int64 if all are whole and float64 would round one.

    shape: for the message of an `InvalidRequest`, which is that of `numbers`
    """
    if isinstance(value, Mapping):
        raise expected(field, f"a list of numbers of shape {shape}", value)
    array = numbers(value, field, EVERY_NUMBER, shape)
    if np.abs(array).max(initial=0.0) < EXACT:
        return array
    leaves = np.array(value, dtype=object).ravel().tolist()
    if not all(INT64.low <= leaf <= INT64.high and leaf == int(leaf) for leaf in leaves):
        return array
    return np.array([int(leaf) for leaf in leaves], np.int64).reshape(array.shape)


def bind(inputs: Inputs, specs: Sequence[TensorSpec]) -> tuple[Inputs, int, bool]:
    """Check inputs against a card: return each as [B,…] in the card's dtype, B, and `batched`.

    Raises `InvalidRequest` if one is missing, unknown or not as the card says.
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


def _own_array(array: NDArray[Any], field: str) -> NDArray[Any]:
    """Return a caller's array, or a copy if the caller could still write to it."""
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
    """Convert numbers to a type of the wire that holds each of them exactly."""
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
    """Return the input in its card's dtype; only exact conversions are allowed."""
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
    # Numbers in JSON have no type.
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
    """Check that the axes agree with the card's and with `sizes`, the axes of earlier inputs."""
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
    if array.dtype.kind == "f":  # finite, if the card has no tighter range
        largest = float(np.finfo(array.dtype).max)
        least, most = max(least, -largest), min(most, largest)
    return within(array, field, Interval(least, most, spec.unit))


def _batched(array: NDArray[Any], spec: TensorSpec, num_scenes: int) -> NDArray[Any]:
    """Return [B,…]; an input without a B axis is repeated for every scene."""
    if array.ndim < len(spec.shape):
        array = np.broadcast_to(array, (num_scenes, *array.shape))
    return read_only(array)


def _shape_of(spec: TensorSpec) -> str:
    one = ",".join(map(str, spec.shape[1:]))
    return f"[{one}] or [{spec.shape[0]},{one}]" if one else f"[] or [{spec.shape[0]}]"
