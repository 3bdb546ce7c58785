"""The contract as JSON, by the standard library and numpy."""

from __future__ import annotations

import base64
import json
from typing import Any

import numpy as np

from anchorflow_client.codec import Payload, answer_fields, answer_of, request_fields
from anchorflow_client.contract import AnchorBatch, AnchorRequest
from anchorflow_client.contract.checks import DTYPES
from anchorflow_client.contract.inputs import EncodedImage, Input
from anchorflow_client.errors import InvalidAnswer, InvalidRequest

COMPACT = json.JSONEncoder(allow_nan=False, separators=(",", ":"))
"""For small headers; `json.dumps` makes an encoder each time."""


class JsonCodec:
    """Reads and writes the JSON of `POST /anchors`; subclasses may bring a faster JSON library."""

    content_type = "application/json"

    def encode_request(self, request: AnchorRequest) -> Payload:
        """Write a request's fields; those left to the card are omitted."""
        fields = request_fields(request)
        if "inputs" in fields:
            fields["inputs"] = {name: _input(value) for name, value in request.inputs.items()}
        return Payload(self._dump(fields))

    def decode_request(self, payload: Payload) -> AnchorRequest:
        """Read a request from untrusted bytes. Raises `InvalidRequest`."""
        return AnchorRequest.from_fields(self._load(payload.body))

    def encode_answer(self, batch: AnchorBatch) -> Payload:
        """Write an answer. Raises `ValueError` if a number is not finite."""
        if not batch.is_finite:
            raise ValueError("the answer holds numbers that are not finite")
        return Payload(self._dump(answer_fields(batch)))

    def decode_answer(self, payload: Payload) -> AnchorBatch:
        """Read an answer from untrusted bytes. Raises `InvalidAnswer`."""
        try:
            fields = self._load(payload.body)
        except InvalidRequest as error:  # reading raises it in both directions
            raise InvalidAnswer(f"not an answer of the contract: {error}") from error
        return answer_of(fields)

    def _dump(self, value: dict[str, Any]) -> bytes:
        return json.dumps(
            value, default=_plain, allow_nan=False, ensure_ascii=False, separators=(",", ":")
        ).encode()

    def _load(self, body: bytes) -> Any:
        return parse(body)


def parse(body: bytes, field: str = "body") -> Any:
    """Parse JSON; NaN and Infinity are accepted, so that the check of a field can name them.

    field: the part of the message that holds the bytes

    Raises:
        InvalidRequest: names `field`: it is no JSON in UTF-8, is nested too deep, or holds an
            integer of more digits than Python reads.
    """
    try:
        return json.loads(body.decode())
    except json.JSONDecodeError as error:
        raise not_json(error.msg, error.pos, len(body), field) from error
    except UnicodeDecodeError as error:
        raise not_json("not UTF-8", error.start, len(body), field) from error
    except (RecursionError, ValueError) as error:
        is_deep = isinstance(error, RecursionError)
        came = "lists nested too deep" if is_deep else "an integer of too many digits"
        raise InvalidRequest(f"expected the contract's JSON, got {came}", field) from error


def not_json(reason: str, position: int, length: int, field: str = "body") -> InvalidRequest:
    """Return the error for bytes that end early or break JSON's grammar."""
    place = f"position {position} of {length}"
    return InvalidRequest(f"expected JSON, got text that breaks at {place}: {reason}", field)


def _input(value: Input) -> Any:
    """Write an input for JSON: numbers as base64, texts as strings."""
    if isinstance(value, EncodedImage):
        return {value.format: base64.b64encode(value.data).decode()}
    if value.dtype.kind == "O":
        return value.tolist()
    dtype = value.dtype.newbyteorder("=").name
    data = np.ascontiguousarray(value, DTYPES[dtype]).tobytes()
    return {"dtype": dtype, "shape": value.shape, "base64": base64.b64encode(data).decode()}


def _plain(value: Any) -> Any:
    """Convert numpy values, which `json` cannot write."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"cannot write a {type(value).__name__} as JSON")
