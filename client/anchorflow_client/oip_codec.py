"""The contract in binary: Open Inference Protocol v2 with the binary tensor extension.

Arrays are tensors, other fields are parameters by their JSON path (`sampler.method`); the request's
id is the protocol's `id`. docs/wire.md shows a request byte by byte.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.codec import Payload, answer_fields, answer_of, request_fields
from anchorflow_client.contract import AnchorBatch, AnchorRequest
from anchorflow_client.contract.batch import ARRAY_DTYPES
from anchorflow_client.contract.checks import boolean, expected, fields_of, text, wrong_shape
from anchorflow_client.contract.fields import REQUEST
from anchorflow_client.contract.inputs import EncodedImage
from anchorflow_client.contract.rows import tensor_paths
from anchorflow_client.errors import InvalidAnswer, InvalidRequest
from anchorflow_client.oip_message import (
    FLOATS,
    Datatypes,
    check_binary_output,
    check_in_binary,
    flatten,
    name_of,
    nest,
    pack,
    scalars,
    unpack_header,
    unpack_tensors,
)

GEOMETRY = "map_geometry"
"""[3] or [B,3]: origin x and y in m, resolution in m/cell; FP64, for maps far from zero."""
TIME_STEP = "dt"
"""A parameter of an answer, or a tensor FP64 [N] if each anchor has its own."""

ROUTES = "routes"

PATH_OF_INPUT = tensor_paths(REQUEST)
"""The JSON paths of the fields that are tensors here, by the name of the tensor."""
RESERVED = {**dict.fromkeys(PATH_OF_INPUT, FLOATS), GEOMETRY: FLOATS}
"""Datatypes of the tensors that are fields of a request; any other tensor is an input."""
OUTPUTS: Datatypes = {
    **{name: (name_of(np.dtype(dtype)),) for name, dtype in ARRAY_DTYPES.items()},
    "trajectories": FLOATS,
    TIME_STEP: FLOATS,
}
INPUTS = "inputs."


class OipCodec:
    """Reads and writes the binary form of `POST /anchors` and of zenoh's payloads."""

    content_type = accept = "application/octet-stream"

    def encode_request(self, request: AnchorRequest) -> Payload:
        fields = request_fields(request)
        header = {"id": fields.pop("request_id")} if "request_id" in fields else {}
        outputs = [{"name": name} for name in fields.pop("outputs", ())]
        leaves = flatten(fields)
        tensors = _request_tensors(leaves)
        parameters = {"binary_data_output": True, **leaves}
        header |= {"parameters": parameters} | ({"outputs": outputs} if outputs else {})
        return pack(header, "inputs", tensors)

    def decode_request(self, payload: Payload) -> AnchorRequest:
        """Read a request from untrusted bytes; its map is a view of them."""
        value, data = unpack_header(payload)
        header = fields_of(value, "", ("id", "parameters", "inputs", "outputs"), ("inputs",))
        leaves = scalars(header.get("parameters"))
        check_binary_output(leaves)
        if outputs := wanted_outputs(header.get("outputs"), in_binary=True):
            for name, in_binary in outputs.items():
                check_in_binary(in_binary, f"{name}.parameters.binary_data")
            leaves["outputs"] = list(outputs)
        tensors = unpack_tensors(header["inputs"], data, "inputs", RESERVED)
        return request_of(tensors, leaves, header.get("id"))

    def encode_answer(self, batch: AnchorBatch) -> Payload:
        leaves = flatten(answer_fields(batch))
        tensors = {name: leaves.pop(name) for name in answer_tensors(batch)}
        header = {
            "model_name": leaves.pop("model.name"),
            "model_version": leaves.pop("model.version"),
        }
        if (request_id := leaves.pop("request_id")) is not None:
            header["id"] = request_id
        return pack({**header, "parameters": leaves}, "outputs", tensors)

    def decode_answer(self, payload: Payload) -> AnchorBatch:
        """Read an answer from untrusted bytes, as views of them. Raises `InvalidAnswer`."""
        try:
            header, data = unpack_header(payload)
            tensors = unpack_tensors(header.get("outputs"), data, "outputs", OUTPUTS)
            leaves = scalars(header.get("parameters"))
            for name, key in (("model.name", "model_name"), ("model.version", "model_version")):
                _put(leaves, name, header.get(key))
            if TIME_STEP in tensors:
                _put(leaves, TIME_STEP, tensors.pop(TIME_STEP))
            if ROUTES in tensors:  # written first, the last of the planner's own arrays
                own = {name: tensors.pop(name) for name in ARRAY_DTYPES if name in tensors}
                tensors = own | tensors
            fields = nest(leaves)
        except InvalidRequest as error:  # reading raises it in both directions
            raise InvalidAnswer(f"not an answer of the contract: {error}") from error
        return answer_of({"timing_ms": {}, **fields, "request_id": header.get("id")}, tensors)


def request_of(
    tensors: Mapping[str, NDArray[Any]], leaves: Mapping[str, Any], request_id: Any
) -> AnchorRequest:
    """Build a request from a message's untrusted parts. Raises `InvalidRequest`."""
    leaves = dict(leaves)
    beside: dict[str, Any] = {
        PATH_OF_INPUT.get(name, INPUTS + name): tensor
        for name, tensor in tensors.items()
        if name != GEOMETRY
    }
    if GEOMETRY in tensors:
        beside |= _geometry_leaves(tensors[GEOMETRY])
    if request_id is not None:
        beside["request_id"] = request_id
    for path, value in beside.items():
        _put(leaves, path, value)
    request = AnchorRequest.from_fields(nest(leaves))
    if GEOMETRY in tensors:
        _check_rows(tensors[GEOMETRY], request.num_scenes)
    return request


def answer_tensors(batch: AnchorBatch) -> list[str]:
    """Return the fields of an answer that are tensors, those of 8 bytes first for alignment."""
    wide = [TIME_STEP] if np.ndim(batch.dt) else []
    if batch.routes is not None:
        wide.append(ROUTES)
    return [*wide, *(name for name in batch.arrays if name != ROUTES)]


def wanted_outputs(outputs: Any, *, in_binary: bool) -> dict[str, bool]:
    """Return the names in a header's `outputs`, and whether each is to be binary.

    in_binary: the default

    Raises:
        InvalidRequest: names the entry.
    """
    if not isinstance(outputs, list | None):
        raise expected("outputs", "a list of outputs", outputs)
    wanted: dict[str, bool] = {}
    for index, value in enumerate(outputs or ()):
        field = f"outputs[{index}]"
        entry = fields_of(value, field, ("name", "parameters"), ("name",))
        name, said = text(entry["name"], f"{field}.name"), entry.get("parameters")
        field += ".parameters"
        said = {} if said is None else fields_of(said, field, ("binary_data",))
        wanted[name] = boolean(said.get("binary_data", in_binary), f"{field}.binary_data")
    return wanted


def _request_tensors(leaves: dict[str, Any]) -> dict[str, NDArray[Any]]:
    """Remove the arrays from a request's leaves; the widest numbers first, for their alignment."""
    tensors = {
        name: np.asarray(leaves.pop(path)) for name, path in PATH_OF_INPUT.items() if path in leaves
    }
    if "cost_map" in tensors:
        geometry = np.array([*leaves.pop("cost_map.origin"), leaves.pop("cost_map.resolution")])
        batch = tensors["cost_map"].shape[:-3]
        tensors[GEOMETRY] = np.broadcast_to(geometry, (*batch, 3)) if batch else geometry
    for path in [path for path in leaves if path.startswith(INPUTS)]:
        name, value = path.removeprefix(INPUTS), leaves.pop(path)
        if isinstance(value, EncodedImage):
            what = f"pixels, uint8 [3,H,W], as the binary form carries no {value.format}"
            raise expected(path, what, value)
        tensors[name] = value
    # No axis of a tensor may be 0: obstacles of which there are none leave only their parameters.
    sent = {name: tensor for name, tensor in tensors.items() if tensor.size}
    return dict(sorted(sent.items(), key=lambda item: -_item_size(item[1])))


def _item_size(tensor: NDArray[Any]) -> int:
    return 0 if tensor.dtype.kind == "O" else tensor.dtype.itemsize


def _put(leaves: dict[str, Any], path: str, value: Any) -> None:
    if path in leaves:
        raise InvalidRequest("expected this field once, got it as a parameter too", path)
    leaves[path] = value


def _geometry_leaves(geometry: NDArray[Any]) -> Mapping[str, Any]:
    """Read the geometry, which all scenes of a batch share."""
    if geometry.ndim not in (1, 2) or geometry.shape[-1] != 3 or not geometry.size:
        raise wrong_shape(GEOMETRY, "[3] or [B,3]", geometry)
    first, *others = rows = geometry.reshape(-1, 3).tolist()
    if not all(map(math.isfinite, chain.from_iterable(rows))):
        raise InvalidRequest("expected finite numbers, got others", GEOMETRY)
    if any(row != first for row in others):
        raise InvalidRequest("expected the same row for every scene, got several", GEOMETRY)
    *origin, resolution = first
    return {"cost_map.origin": origin, "cost_map.resolution": resolution}


def _check_rows(geometry: NDArray[Any], num_scenes: int) -> None:
    if geometry.ndim == 2 and len(geometry) != num_scenes:
        raise wrong_shape(GEOMETRY, f"[3] or [{num_scenes},3], a row for every scene", geometry)
