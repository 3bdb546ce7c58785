"""A message: a JSON header, padded with spaces, and the tensors that it lists, one after another.

    {"inputs": [{"name", "datatype", "shape", "parameters": {"binary_data_size"}}, …], …}␠␠␠
    <first tensor><second tensor>…

Nothing is believed: a tensor is read only where its shape, its declared size and the bytes that
came agree, so that no header asks for more memory than its body holds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.codec import Payload
from anchorflow_client.contract.checks import choice, expected, fields_of, text
from anchorflow_client.contract.ranges import MAX_AXES
from anchorflow_client.errors import InvalidRequest
from anchorflow_client.json_codec import COMPACT, parse
from anchorflow_client.oip.datatypes import (
    BYTES,
    DATATYPES,
    DTYPE_OF,
    name_of,
    texts_from_wire,
    to_wire,
)

ALIGNMENT = 64
"""Bytes that the padded header is a multiple of, so that the tensors behind it are aligned."""
MAX_HEADER_BYTES = 64 * 1024
"""Longest header that is parsed; an honest one has one or two KiB."""

Tensors = Mapping[str, NDArray[Any]]
Datatypes = Mapping[str, Sequence[str]]
"""The datatypes that a reader takes, by the name of the tensor; of any other name all of them."""


def pack(fields: Mapping[str, Any], role: str, tensors: Tensors) -> Payload:
    """The bytes of a message.

    Args:
        fields: what the header says beside its tensors, in JSON's types.
        role: "inputs" or "outputs", the header's key for the tensors.
        tensors: of a type of `datatypes`, in the order in which they are sent.
    """
    parts = [to_wire(tensor) for tensor in tensors.values()]
    entries = [
        {
            "name": name,
            "datatype": name_of(tensor.dtype),
            "shape": tensor.shape,
            "parameters": {"binary_data_size": part.nbytes},
        }
        for (name, tensor), part in zip(tensors.items(), parts, strict=True)
    ]
    header = COMPACT.encode({**fields, role: entries}).encode()
    header += b" " * (-len(header) % ALIGNMENT)
    return Payload(b"".join([header, *parts]), len(header))


def unpack_header(payload: Payload) -> tuple[Mapping[str, Any], memoryview]:
    """The header and the bytes behind it, read-only and not copied. Raises `InvalidRequest`."""
    body, length = memoryview(payload.body).toreadonly(), payload.header_length
    if length is None:
        beside = "Inference-Header-Content-Length in HTTP, header_length in zenoh's attachment"
        raise InvalidRequest(
            f"expected the length of the JSON header ({beside}), got none", "header_length"
        )
    if not 0 < length <= min(len(body), MAX_HEADER_BYTES):
        most = f"{MAX_HEADER_BYTES}, in a body of {len(body)}"
        raise InvalidRequest(f"expected 1 to {most} bytes, got {length}", "header_length")
    return _parsed(bytes(body[:length])), body[length:]


def unpack_tensors(
    entries: Any, data: memoryview, role: str, known: Datatypes
) -> dict[str, NDArray[Any]]:
    """The tensors that a header lists: read-only views of `data`, only texts are copied.

    Args:
        entries: what stands under the header's `role`.
        data: the bytes behind the header.
        role: "inputs" or "outputs", for messages.
        known: of which datatypes a tensor may be.

    Raises:
        InvalidRequest: names the tensor, or "body" where the lengths do not add up.
    """
    if not isinstance(entries, list):
        raise expected(role, "a list of tensors", entries)
    tensors: dict[str, NDArray[Any]] = {}
    offset = 0
    for index, value in enumerate(entries):
        entry = _Entry.read(value, f"{role}[{index}]")
        part = data[offset : offset + entry.size]
        offset += entry.size
        if entry.name in tensors:
            raise InvalidRequest(f"expected one tensor of this name, got two in {role}", entry.name)
        tensors[entry.name] = entry.view(part, known.get(entry.name, DATATYPES))
    if offset != len(data):
        came = f"{len(data)} bytes behind the header"
        raise InvalidRequest(f"expected {offset}, as its tensors declare, got {came}", "body")
    return tensors


class _Entry(NamedTuple):
    """What a header says of one tensor."""

    field: str
    """Where it stands, such as inputs[2]."""
    name: str
    datatype: Any
    shape: Any
    size: int
    """Bytes that it declares."""

    @classmethod
    def read(cls, value: Any, field: str) -> _Entry:
        names = ("name", "datatype", "shape", "parameters")
        entry = fields_of(value, field, names, required=names)
        name = text(entry["name"], f"{field}.name")
        parameters = fields_of(
            entry["parameters"], f"{name}.parameters", ("binary_data_size",), ("binary_data_size",)
        )
        size = parameters["binary_data_size"]
        if not _is_count(size, at_least=0):
            raise expected(f"{name}.parameters.binary_data_size", "a number of bytes", size)
        return cls(field, name, entry["datatype"], entry["shape"], size)

    def view(self, part: memoryview, datatypes: Sequence[str]) -> NDArray[Any]:
        """The tensor in `part`, whose shape, type and size agree."""
        datatype = choice(self.datatype, self.name, datatypes)
        shape = checked_shape(self.shape, self.name)
        # Python's own integers: a product of lying axes overflows none.
        wanted = self.size if datatype == BYTES else math.prod(shape) * DTYPE_OF[datatype].itemsize
        if wanted != self.size:
            declared = f"a binary_data_size of {self.size}"
            what = f"{wanted} bytes for {self.datatype} {shape}"
            raise InvalidRequest(f"expected {what}, got {declared}", self.name)
        if len(part) != self.size:
            raise InvalidRequest(f"expected {self.size} bytes, got {len(part)}", self.name)
        if datatype == BYTES:
            return texts_from_wire(part, shape, self.name)
        return _array(part, DTYPE_OF[datatype], self.name).reshape(shape)


def checked_shape(shape: Any, name: str) -> list[int]:
    """The shape that a header gives a tensor. Raises `InvalidRequest`."""
    if not (isinstance(shape, list) and len(shape) <= MAX_AXES):
        raise expected(name, f"a shape of at most {MAX_AXES} axes", shape)
    for size in shape:
        if not _is_count(size, at_least=1):
            raise expected(name, "a shape of whole numbers from 1 on", size)
    return shape


def _is_count(value: Any, *, at_least: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= at_least


def _array(part: memoryview, dtype: np.dtype, name: str) -> NDArray[Any]:
    if dtype != np.bool_:
        return np.frombuffer(part, dtype)
    values = np.frombuffer(part, np.uint8)
    if (values > 1).any():
        raise InvalidRequest(f"expected bytes of 0 or 1, got {int(values.max())}", name)
    return values.view(np.bool_)


def _parsed(header: bytes) -> Mapping[str, Any]:
    value = parse(header, "header")
    if not isinstance(value, Mapping):
        raise expected("header", "an object", value)
    return value
