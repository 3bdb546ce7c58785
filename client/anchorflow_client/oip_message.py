"""A message: a JSON header, padded with spaces, and the tensors that it lists, one after another.

    {"inputs": [{"name", "datatype", "shape", "parameters": {"binary_data_size"}}, …], …}␠␠␠
    <first tensor><second tensor>…

Nothing is believed: a tensor is read only where its shape, its declared size and the bytes that
came agree, so that no header asks for more memory than its body holds.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.codec import Payload
from anchorflow_client.contract.checks import MAX_AXES, boolean, choice, expected, fields_of, text
from anchorflow_client.contract.inputs import texts
from anchorflow_client.errors import InvalidRequest
from anchorflow_client.json_codec import COMPACT, parse

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


def flatten(fields: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Every leaf by its JSON path."""
    leaves: dict[str, Any] = {}
    for name, value in fields.items():
        if isinstance(value, Mapping):
            leaves |= flatten(value, f"{prefix}{name}.")
        else:
            leaves[prefix + name] = value
    return leaves


def nest(leaves: Mapping[str, Any]) -> dict[str, Any]:
    """`flatten` undone.

    Raises:
        InvalidRequest: one path runs through another.
    """
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
    """The parameters of a header: strings, numbers and booleans by name.

    Raises:
        InvalidRequest: one is something else, or has a name that no message could carry.
    """
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
    """Take `binary_data_output` out. Raises `InvalidRequest` where it asks for outputs in JSON."""
    field = "binary_data_output"
    check_in_binary(boolean(leaves.pop(field, True), field), field)


def check_in_binary(wanted: bool, field: str) -> None:
    """Raises `InvalidRequest` where not."""
    if not wanted:
        raise InvalidRequest(
            "expected true, as answers have the form of requests, got false", field
        )
