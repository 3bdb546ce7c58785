"""The contract as JSON, with nothing but the standard library and numpy."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.codec import Payload
from anchorflow_client.contract import AnchorBatch, AnchorRequest, CostMap, ModelId, WarmStart
from anchorflow_client.contract.batch import ARRAY_DTYPES
from anchorflow_client.contract.sampling import given
from anchorflow_client.errors import InvalidAnswer, InvalidRequest


class JsonCodec:
    """Reads and writes the JSON of `POST /anchors`.

    A faster JSON library takes over by overriding `_dump` and `_load`.
    """

    content_type = "application/json"

    def encode_request(self, request: AnchorRequest) -> Payload:
        """The request's fields, those left to the card omitted."""
        return Payload(self._dump(_request_fields(request)))

    def decode_request(self, payload: Payload) -> AnchorRequest:
        """A request out of untrusted bytes. Raises `InvalidRequest`."""
        return AnchorRequest.from_fields(self._load(payload.body))

    def encode_answer(self, batch: AnchorBatch) -> Payload:
        """The answer. Raises `ValueError` where a number is not finite."""
        if not batch.is_finite:
            raise ValueError("the answer holds numbers that are not finite")
        return Payload(self._dump(_answer_fields(batch)))

    def decode_answer(self, payload: Payload) -> AnchorBatch:
        """An answer out of untrusted bytes. Raises `InvalidAnswer`."""
        try:
            batch = _answer(json.loads(payload.body))
        except _UNREADABLE as error:
            raise InvalidAnswer(f"not an answer of the contract: {error!r}") from error
        if not batch.is_finite:
            raise InvalidAnswer("the answer holds numbers that are not finite")
        return batch

    def _dump(self, value: dict[str, Any]) -> bytes:
        return json.dumps(
            value, default=_plain, allow_nan=False, ensure_ascii=False, separators=(",", ":")
        ).encode()

    def _load(self, body: bytes) -> Any:
        """Parsed JSON; NaN and Infinity come through, for the field's own check to name them."""
        try:
            return json.loads(body)
        except json.JSONDecodeError as error:
            raise not_json(error.msg, error.pos, len(body)) from error
        except UnicodeDecodeError as error:
            raise not_json("not UTF-8", error.start, len(body)) from error
        # Lists nested beyond any contract, or an integer of thousands of digits.
        except (RecursionError, ValueError) as error:
            raise InvalidRequest(f"expected the contract's JSON, got {error}", "body") from error


# What walking through JSON of another shape than expected raises.
_UNREADABLE = (
    ValueError,
    TypeError,
    KeyError,
    AttributeError,
    OverflowError,
    RecursionError,
)


def not_json(reason: str, position: int, length: int) -> InvalidRequest:
    """The refusal of a body that breaks off, or breaks JSON's grammar."""
    place = f"position {position} of {length}"
    return InvalidRequest(f"expected JSON, got a body that breaks at {place}: {reason}", "body")


def _plain(value: Any) -> Any:
    """What `json` cannot write by itself, as it can."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"cannot write a {type(value).__name__} as JSON")


def _request_fields(request: AnchorRequest) -> dict[str, Any]:
    fields = request.field_values()
    batched = fields.pop("batched")
    for name in ("x_curr", "x_goal", "w_style"):
        fields[name] = fields[name] if batched else fields[name][0]
    fields["cost_map"] = _map_fields(request.cost_map, batched=batched)
    fields["sampler"] = request.sampler and given(request.sampler)
    fields["refine"] = request.refine and given(request.refine)
    fields["warm_start"] = request.warm_start and _warm_start_fields(request.warm_start)
    return {name: value for name, value in fields.items() if value is not None}


def _map_fields(cost_map: CostMap, *, batched: bool) -> dict[str, Any]:
    # One map broadcast over a batch, which numpy tells by a stride of 0, is sent once.
    shared = not batched or cost_map.data.strides[0] == 0
    data: NDArray[np.float32] = cost_map.data[0] if shared else cost_map.data
    return {"data": data, "resolution": cost_map.resolution, "origin": cost_map.origin}


def _warm_start_fields(warm_start: WarmStart) -> dict[str, Any]:
    return {"trajectory": warm_start.trajectory, "tau": warm_start.tau}


def _answer_fields(batch: AnchorBatch) -> dict[str, Any]:
    return {name: getattr(batch, name) for name in ARRAY_DTYPES} | {
        "dt": batch.dt,
        "seed": batch.seed,
        "model": asdict(batch.model),
        "timing_ms": dict(batch.timing_ms),
        "request_id": batch.request_id,
    }


def _answer(fields: dict[str, Any]) -> AnchorBatch:
    """Keys that this version does not know are left out; a later service may send them."""
    model = fields["model"]
    arrays: dict[str, Any] = {
        name: np.array(fields[name], dtype=dtype) for name, dtype in ARRAY_DTYPES.items()
    }
    return AnchorBatch(
        **arrays,
        dt=float(fields["dt"]),
        seed=int(fields["seed"]),
        model=ModelId(model["name"], model["version"], model["sha256"]),
        timing_ms={str(stage): float(ms) for stage, ms in fields["timing_ms"].items()},
        request_id=fields.get("request_id"),
    )
