"""The JSON codec at orjson's speed: numpy arrays are written as they lie."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import orjson

from anchorflow_client import json_codec
from anchorflow_client.codec import Payload
from anchorflow_client.contract import AnchorRequest
from anchorflow_client.json_codec import JsonCodec, not_json
from anchorflow_service.http.images import with_map, with_pixels

# What the standard library reads and orjson does not: NaN, Infinity, numbers beyond float64.
_NOT_FINITE = re.compile(r"NaN|Infinity|[-\d]")


def dump(value: Any) -> bytes:
    """JSON of plain types and numpy arrays; a number that is not finite becomes null."""
    return orjson.dumps(value, default=_contiguous, option=orjson.OPT_SERIALIZE_NUMPY)


def parse(body: bytes) -> Any:
    """As `json_codec.parse`. Raises `InvalidRequest`."""
    try:
        return orjson.loads(body)
    except orjson.JSONDecodeError as error:
        if _NOT_FINITE.match(error.doc, error.pos):
            # Read again by a parser that lets them through, so that they are refused by field.
            return json_codec.parse(body)
        raise not_json(error.msg, error.pos, len(body)) from error


class OrjsonCodec(JsonCodec):
    """The contract as JSON, on the service's side, where pictures are decoded."""

    def decode_request(self, payload: Payload) -> AnchorRequest:
        """A request out of untrusted bytes. Raises `InvalidRequest`."""
        return with_pixels(AnchorRequest.from_fields(with_map(self._load(payload.body))))

    def _dump(self, value: dict[str, Any]) -> bytes:
        return dump(value)

    def _load(self, body: bytes) -> Any:
        return parse(body)


def _contiguous(value: Any) -> Any:
    """orjson takes an array in C order only."""
    if isinstance(value, np.ndarray) and not value.flags.c_contiguous:
        return np.ascontiguousarray(value)
    raise TypeError(f"cannot write a {type(value).__name__} as JSON")
