"""The Open Inference Protocol for any of its clients: each tensor in binary or in JSON.

`POST /anchors` and zenoh carry all tensors in binary. Here the client chooses for each tensor, and
may list the outputs that it needs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.codec import Payload, answer_fields
from anchorflow_client.contract import AnchorBatch, AnchorRequest
from anchorflow_client.contract.checks import (
    Interval,
    boolean,
    choice,
    expected,
    fields_of,
    first_refused,
    number,
    text,
)
from anchorflow_client.contract.fields import BUDGET
from anchorflow_client.contract.inputs import exact_numbers, texts
from anchorflow_client.errors import InvalidRequest
from anchorflow_client.oip_codec import (
    RESERVED,
    TIME_STEP,
    answer_tensors,
    request_of,
    wanted_outputs,
)
from anchorflow_client.oip_message import (
    ALIGNMENT,
    BYTES,
    DATATYPES,
    DTYPE_OF,
    checked_shape,
    flatten,
    name_of,
    scalars,
    to_wire,
    unpack_header,
    unpack_tensors,
)
from anchorflow_service.http.orjson_codec import dump, parse

MAX_ENTRIES = 64
"""The most parameters, inputs and outputs of a request, each; about 20 are in use."""
TIMEOUT = "timeout"
"""Triton's parameter for a budget, in microseconds."""


class InferCodec:
    """Reads one request to `…/infer` and writes its answer in the form that the request chose.

    Each request needs a new one.
    """

    def __init__(self) -> None:
        self._wanted: dict[str, bool] = {}
        """The outputs that the request listed, and whether in binary; empty means all."""
        self._in_binary = False
        """The default for outputs."""

    def decode_request(self, payload: Payload) -> AnchorRequest:
        """Read a request, which is all JSON without a header length."""
        value, data = (
            (parse(bytes(payload.body)), memoryview(b""))
            if payload.header_length is None
            else unpack_header(payload)
        )
        header = fields_of(value, "", ("id", "parameters", "inputs", "outputs"), ("inputs",))
        for name in ("parameters", "inputs", "outputs"):
            _check_few(header.get(name), name)
        leaves = scalars(header.get("parameters"))
        self._in_binary = boolean(leaves.pop("binary_data_output", False), "binary_data_output")
        self._wanted = wanted_outputs(header.get("outputs"), in_binary=self._in_binary)
        if self._wanted:
            leaves["outputs"] = list(self._wanted)
        if TIMEOUT in leaves:
            if "budget_ms" in leaves:
                raise InvalidRequest("expected this field or budget_ms, got both", TIMEOUT)
            timeout_us = Interval(BUDGET.low * 1e3, BUDGET.high * 1e3, "µs", open_low=True)
            leaves["budget_ms"] = number(leaves.pop(TIMEOUT), TIMEOUT, timeout_us) / 1e3
        return request_of(_tensors(header["inputs"], data), leaves, header.get("id"))

    def encode_answer(self, batch: AnchorBatch) -> Payload:
        leaves = flatten(answer_fields(batch))
        tensors = {name: leaves.pop(name) for name in answer_tensors(batch)}
        wanted = self._wanted_of(tensors)
        parts = {name: to_wire(tensors[name]) for name, in_binary in wanted.items() if in_binary}
        header = {
            "model_name": leaves.pop("model.name"),
            "model_version": leaves.pop("model.version"),
            "id": leaves.pop("request_id") or "",
            "parameters": leaves,
            "outputs": [_output(name, tensors[name], parts.get(name)) for name in wanted],
        }
        written = dump(header)
        if not parts:
            return Payload(written)
        written += b" " * (-len(written) % ALIGNMENT)
        return Payload(b"".join([written, *parts.values()]), len(written))

    def _wanted_of(self, tensors: Mapping[str, Any]) -> dict[str, bool]:
        """Return which tensors to send, and whether in binary; always with the time step."""
        if not self._wanted:
            return dict.fromkeys(tensors, self._in_binary)
        wanted = {TIME_STEP: self._in_binary} | self._wanted
        return {name: in_binary for name, in_binary in wanted.items() if name in tensors}


def _check_few(entries: Any, field: str) -> None:
    if isinstance(entries, list | Mapping) and len(entries) > MAX_ENTRIES:
        raise InvalidRequest(f"expected at most {MAX_ENTRIES} entries, got {len(entries)}", field)


def _tensors(inputs: Any, data: memoryview) -> Mapping[str, NDArray[Any]]:
    """Read the tensors of a header, whose data are in it or follow it."""
    if not isinstance(inputs, list):
        raise expected("inputs", "a list of tensors", inputs)
    in_json = [isinstance(value, Mapping) and "data" in value for value in inputs]
    behind = [value for value, inside in zip(inputs, in_json, strict=True) if not inside]
    tensors = unpack_tensors(behind, data, "inputs", RESERVED)
    for index, value in enumerate(inputs):
        if in_json[index]:
            name, tensor = _json_tensor(value, f"inputs[{index}]")
            if name in tensors:
                raise InvalidRequest("expected one tensor of this name, got two in inputs", name)
            tensors[name] = tensor
    return tensors


def _json_tensor(value: Any, field: str) -> tuple[str, NDArray[Any]]:
    """Read a tensor whose data, flat or nested, are in the header."""
    names = ("name", "datatype", "shape", "data")
    entry = fields_of(value, field, names, required=names)
    name = text(entry["name"], f"{field}.name")
    datatype = choice(entry["datatype"], name, RESERVED.get(name, DATATYPES))
    shape = checked_shape(entry["shape"], name)
    if datatype == BYTES:
        tensor = _texts(entry["data"], name)
    else:
        tensor = _numbers(entry["data"], datatype, name, shape)
    if tensor.size != math.prod(shape):
        raise InvalidRequest(f"expected shape {shape}, got {tensor.size} elements", name)
    return name, tensor.reshape(shape)


def _numbers(data: Any, datatype: str, name: str, shape: list[int]) -> NDArray[Any]:
    """Convert numbers to their declared type; floats may lose digits, integers may not."""
    dtype = DTYPE_OF[datatype]
    if dtype == np.bool_ and set(map(type, (leaves := np.array(data, object)).flat)) == {bool}:
        return leaves.astype(np.bool_)
    values = exact_numbers(data, name, str(shape))
    with np.errstate(all="ignore"):
        tensor = values.astype(dtype)
    lost = ~np.isfinite(tensor) if dtype.kind == "f" else tensor != values
    if lost.any():
        raise first_refused(values, lost, name, f"numbers that {datatype} holds")
    return tensor


def _texts(value: Any, name: str) -> NDArray[Any]:
    if not isinstance(value, list) or not all(isinstance(each, str) for each in value):
        raise expected(name, "a flat list of strings", value)
    return texts(value, name, (len(value),))


def _output(name: str, tensor: NDArray[Any], part: memoryview | None) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "name": name,
        "datatype": name_of(tensor.dtype),
        "shape": tensor.shape,
    }
    if part is None:
        return entry | {"data": np.ascontiguousarray(tensor).reshape(-1)}
    return entry | {"parameters": {"binary_data_size": part.nbytes}}
