"""The protocol's names of the types that anchors are made of; little-endian on the wire."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract.inputs import texts
from anchorflow_client.errors import InvalidRequest

DTYPE_OF: dict[str, np.dtype] = {
    "FP32": np.dtype("<f4"),
    "FP64": np.dtype("<f8"),
    "INT64": np.dtype("<i8"),
    "UINT8": np.dtype("u1"),
    "BOOL": np.dtype("?"),
}
BYTES = "BYTES"
"""Texts in UTF-8, each behind its length in four bytes."""
FLOATS = ("FP32", "FP64")
DATATYPES = (*DTYPE_OF, BYTES)

_NAME_OF = {dtype.newbyteorder("="): name for name, dtype in DTYPE_OF.items()}
_LENGTH = struct.Struct("<I")


def name_of(dtype: np.dtype) -> str:
    """The protocol's name of a type; arrays of objects are arrays of `str`."""
    if dtype.kind == "O":
        return BYTES
    return _NAME_OF.get(dtype) or _NAME_OF[dtype.newbyteorder("=")]


def datatype_of(dtype: str) -> str:
    """The protocol's name of a card's dtype."""
    return BYTES if dtype == "text" else name_of(np.dtype(dtype))


def to_wire(tensor: NDArray[Any]) -> memoryview:
    """A tensor's bytes in C order; no copy where it lies so already."""
    if tensor.dtype.kind == "O":
        parts = [text.encode() for text in tensor.flat]
        return memoryview(b"".join(_LENGTH.pack(len(part)) + part for part in parts))
    ordered = np.ascontiguousarray(tensor, dtype=DTYPE_OF[name_of(tensor.dtype)])
    return ordered.reshape(-1).view(np.uint8).data


def texts_from_wire(part: memoryview, shape: Sequence[int], field: str) -> NDArray[Any]:
    """The texts of a BYTES tensor. Raises `InvalidRequest` where the lengths do not add up."""
    count, values, offset = int(np.prod(shape, dtype=object)), [], 0
    while len(values) < count and offset + _LENGTH.size <= len(part):
        (length,) = _LENGTH.unpack_from(part, offset)
        offset += _LENGTH.size
        values.append(_decoded(bytes(part[offset : offset + length]), length, field))
        offset += length
    if len(values) != count or offset != len(part):
        came = f"{len(values)} in {offset} of {len(part)} bytes"
        raise InvalidRequest(f"expected {count} texts, got {came}", field)
    return texts(values, field, shape)


def _decoded(data: bytes, length: int, field: str) -> str:
    if len(data) != length:
        raise InvalidRequest(f"expected a text of {length} bytes, got {len(data)}", field)
    try:
        return data.decode()
    except UnicodeDecodeError as error:
        raise InvalidRequest(f"expected text in UTF-8, got {error}", field) from error
