"""The contract in binary: Open Inference Protocol v2 with the binary tensor extension.

Arrays travel as tensors, everything else as parameters by its JSON path (`sampler.method`); the
request's id is the protocol's `id`. docs/wire.md shows a request byte by byte.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.codec import Payload
from anchorflow_client.contract import AnchorBatch, AnchorRequest
from anchorflow_client.contract.arrays import wrong_shape
from anchorflow_client.contract.batch import ARRAY_DTYPES
from anchorflow_client.contract.checks import fields_of
from anchorflow_client.errors import InvalidAnswer, InvalidRequest
from anchorflow_client.oip.datatypes import FLOATS, name_of
from anchorflow_client.oip.message import pack, unpack_header, unpack_tensors
from anchorflow_client.oip.parameters import check_binary_output, flatten, nest, scalars
from anchorflow_client.wire_fields import answer_fields, answer_of, request_fields

GEOMETRY = "map_geometry"
"""[3] or [B,3]: origin x and y in m, resolution in m/cell."""

# Tensors of 8-byte numbers come first, so that each begins at a multiple of its own item size.
PATH_OF_INPUT = {
    "x_curr": "x_curr",
    "x_goal": "x_goal",
    "w_style": "w_style",
    "warm_start": "warm_start.trajectory",
    "schedule": "sampler.schedule",
    "cost_map": "cost_map.data",
}
INPUTS = {**dict.fromkeys(PATH_OF_INPUT, FLOATS), GEOMETRY: FLOATS}
OUTPUTS = {name: (name_of(np.dtype(dtype)),) for name, dtype in ARRAY_DTYPES.items()}


class OipCodec:
    """Reads and writes the binary form of `POST /anchors` and of zenoh's payloads."""

    content_type = "application/octet-stream"

    def encode_request(self, request: AnchorRequest) -> Payload:
        """The request's fields, those left to the card omitted."""
        fields = request_fields(request)
        header = {"id": fields.pop("request_id")} if "request_id" in fields else {}
        leaves = flatten(fields)
        geometry = [*leaves.pop("cost_map.origin"), leaves.pop("cost_map.resolution")]
        tensors = {
            name: np.asarray(leaves.pop(path))
            for name, path in PATH_OF_INPUT.items()
            if path in leaves
        }
        batch = tensors["cost_map"].shape[:-3]
        tensors[GEOMETRY] = np.broadcast_to(np.array(geometry, np.float32), (*batch, 3))
        parameters = {"binary_data_output": True, **leaves}
        return pack({**header, "parameters": parameters}, "inputs", tensors)

    def decode_request(self, payload: Payload) -> AnchorRequest:
        """A request out of untrusted bytes; its map is the body's own memory.

        Raises:
            InvalidRequest: names the field, the tensor, "header_length", "header" or "body".
        """
        value, data = unpack_header(payload)
        header = fields_of(value, "", ("id", "parameters", "inputs"), ("inputs",))
        leaves = scalars(header.get("parameters"))
        check_binary_output(leaves)
        tensors = unpack_tensors(header["inputs"], data, "inputs", INPUTS)
        return request_of(tensors, leaves, header.get("id"))

    def encode_answer(self, batch: AnchorBatch) -> Payload:
        """The answer. Raises `ValueError` where a number is not finite."""
        if not batch.is_finite:
            raise ValueError("the answer holds numbers that are not finite")
        leaves = flatten(answer_fields(batch))
        tensors: dict[str, NDArray[Any]] = {name: leaves.pop(name) for name in ARRAY_DTYPES}
        header = {
            "model_name": leaves.pop("model.name"),
            "model_version": leaves.pop("model.version"),
        }
        if (request_id := leaves.pop("request_id")) is not None:
            header["id"] = request_id
        return pack({**header, "parameters": leaves}, "outputs", tensors)

    def decode_answer(self, payload: Payload) -> AnchorBatch:
        """An answer out of untrusted bytes; its arrays are the body's own memory.

        Raises:
            InvalidAnswer: the bytes are not the contract's.
        """
        try:
            header, data = unpack_header(payload)
            tensors = unpack_tensors(
                header.get("outputs"), data, "outputs", OUTPUTS, take_strangers=True
            )
            leaves = scalars(header.get("parameters"))
            for name, key in (("model.name", "model_name"), ("model.version", "model_version")):
                _put(leaves, name, header.get(key))
            fields = nest(leaves)
        except InvalidRequest as error:  # the reader's words for both directions
            raise InvalidAnswer(f"not an answer of the contract: {error}") from error
        missing = [name for name in OUTPUTS if name not in tensors]
        if missing:
            raise InvalidAnswer(f"not an answer of the contract: {', '.join(missing)} missing")
        told = {"timing_ms": {}, **fields, **tensors, "request_id": header.get("id")}
        return answer_of(told)


def request_of(
    tensors: Mapping[str, NDArray[Any]], leaves: Mapping[str, Any], request_id: Any
) -> AnchorRequest:
    """The request that a message's tensors, parameters and id make up; all may be untrusted.

    Raises:
        InvalidRequest: names the field or the tensor.
    """
    leaves = dict(leaves)
    if GEOMETRY in tensors:
        leaves |= _geometry_leaves(tensors[GEOMETRY])
    for name, path in PATH_OF_INPUT.items():
        if name in tensors:
            _put(leaves, path, tensors[name])
    if request_id is not None:
        _put(leaves, "request_id", request_id)
    return AnchorRequest.from_fields(nest(leaves))


def _put(leaves: dict[str, Any], path: str, value: Any) -> None:
    if path in leaves:
        raise InvalidRequest("expected this field once, got it as a parameter too", path)
    leaves[path] = value


def _geometry_leaves(geometry: NDArray[Any]) -> Mapping[str, Any]:
    """The contract knows one geometry a request: the scenes of a batch must agree."""
    if geometry.ndim not in (1, 2) or geometry.shape[-1] != 3 or not geometry.size:
        raise wrong_shape(GEOMETRY, "[3] or [B,3]", geometry)
    rows = geometry.reshape(-1, 3)
    if not np.isfinite(rows).all():
        raise InvalidRequest("expected finite numbers, got others", GEOMETRY)
    if (rows != rows[0]).any():
        raise InvalidRequest("expected the same row for every scene, got several", GEOMETRY)
    *origin, resolution = rows[0].tolist()
    return {"cost_map.origin": origin, "cost_map.resolution": resolution}
