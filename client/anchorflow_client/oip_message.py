"""Messages of the Open Inference Protocol: a padded JSON header, then the tensors that it lists.

    {"inputs": [{"name", "datatype", "shape", "parameters": {"binary_data_size"}}, …], …}␠␠␠
    <first tensor><second tensor>…

A tensor is read only if its shape, its declared size and the received bytes agree, so that no
header can claim more memory than its body has.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.codec import COMPACT, Payload, parse
from anchorflow_client.contract.checks import MAX_AXES, boolean, choice, expected, fields_of, text
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
"""Texts in UTF-8, each after its length in four bytes."""
FLOATS = ("FP32", "FP64")
DATATYPES = (*DTYPE_OF, BYTES)

_NAME_OF = {dtype.newbyteorder("="): name for name, dtype in DTYPE_OF.items()}
_LENGTH = struct.Struct("<I")


def name_of(dtype: np.dtype) -> str:
    """Return the protocol's name of a type; object arrays hold `str`."""
    if dtype.kind == "O":
        return BYTES
    return _NAME_OF.get(dtype) or _NAME_OF[dtype.newbyteorder("=")]


def datatype_of(dtype: str) -> str:
    """Return the protocol's name of a card's dtype."""
    return BYTES if dtype == "text" else name_of(np.dtype(dtype))


def to_wire(tensor: NDArray[Any]) -> memoryview:
    """Return a tensor's bytes in C order, without a copy if it is contiguous."""
    if tensor.dtype.kind == "O":
        parts = [text.encode() for text in tensor.flat]
        return memoryview(b"".join(_LENGTH.pack(len(part)) + part for part in parts))
    ordered = np.ascontiguousarray(tensor, dtype=DTYPE_OF[name_of(tensor.dtype)])
    return ordered.reshape(-1).view(np.uint8).data


def texts_from_wire(part: memoryview, shape: Sequence[int], field: str) -> NDArray[Any]:
    """Read a BYTES tensor. Raises `InvalidRequest` if the lengths do not add up."""
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


ALIGNMENT = 64
"""The padded header is a multiple of these bytes, which aligns the tensors after it."""
MAX_HEADER_BYTES = 64 * 1024
"""The longest header that is parsed; usual ones have one or two KiB."""

Tensors = Mapping[str, NDArray[Any]]
Datatypes = Mapping[str, Sequence[str]]
"""The accepted datatypes by the name of the tensor; other tensors may have any."""


def pack(fields: Mapping[str, Any], role: str, tensors: Tensors) -> Payload:
    """Write a message.

    Args:
        fields: the header's other fields, in JSON's types.
        role: "inputs" or "outputs", the header's key for the tensors.
        tensors: in the order in which they are sent.
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
    """Return the header and a read-only view of the bytes after it. Raises `InvalidRequest`."""
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
    """Return the tensors that a header lists as read-only views of `data`; texts are copied.

    Args:
        entries: the header's value under `role`.
        data: the bytes after the header.
        role: "inputs" or "outputs", for messages.
        known: the accepted datatypes.

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
    """A header's entry for one tensor."""

    field: str
    """Its JSON path, such as inputs[2]."""
    name: str
    datatype: Any
    shape: Any
    size: int
    """The declared bytes."""

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
        """Return the tensor in `part` if its shape, type and size agree."""
        datatype = choice(self.datatype, self.name, datatypes)
        shape = checked_shape(self.shape, self.name)
        # Python's integers: the product of false sizes cannot overflow.
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
    """Return a tensor's shape from a header. Raises `InvalidRequest`."""
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


def flatten(fields: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return every leaf by its JSON path: nested fields as flat parameters."""
    leaves: dict[str, Any] = {}
    for name, value in fields.items():
        if isinstance(value, Mapping):
            leaves |= flatten(value, f"{prefix}{name}.")
        else:
            leaves[prefix + name] = value
    return leaves


def nest(leaves: Mapping[str, Any]) -> dict[str, Any]:
    """Undo `flatten`. Raises `InvalidRequest` if one path is a prefix of another."""
    fields: dict[str, Any] = {}
    for path, value in leaves.items():
        *parents, name = path.split(".")
        place = fields
        for parent in parents:
            place = place.setdefault(parent, {})
            if not isinstance(place, dict):
                raise InvalidRequest(f"expected a value or fields in {parent}, got both", path)
        if name in place:
            raise InvalidRequest(f"expected a value or fields in {name}, got both", path)
        place[name] = value
    return fields


def scalars(value: Any) -> dict[str, Any]:
    """Return a header's parameters: strings, numbers and booleans. Raises `InvalidRequest`."""
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise expected("parameters", "an object", value)
    for name, scalar in value.items():
        text(name, "parameters")
        if not isinstance(scalar, str | int | float):
            raise expected(name, "a string, a number or a boolean", scalar)
    return dict(value)


def check_binary_output(leaves: dict[str, Any]) -> None:
    """Remove `binary_data_output`. Raises `InvalidRequest` if it is false."""
    field = "binary_data_output"
    check_in_binary(boolean(leaves.pop(field, True), field), field)


def check_in_binary(wanted: bool, field: str) -> None:
    """Raise `InvalidRequest` if outputs are to be in JSON."""
    if not wanted:
        raise InvalidRequest(
            "expected true, as answers have the form of requests, got false", field
        )
