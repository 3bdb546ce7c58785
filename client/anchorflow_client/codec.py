"""How a request and an answer become bytes: their fields on the wire, and the JSON form.

Clients and services hold a `Codec` and never look inside, so that another form of the contract, or
a faster writer of the same form, is one more class.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import (
    AnchorBatch,
    AnchorRequest,
    CostMap,
    GoalTolerance,
    ModelId,
    Obstacles,
    WarmStart,
)
from anchorflow_client.contract.batch import ARRAY_DTYPES
from anchorflow_client.contract.checks import DTYPES, array_of_bytes
from anchorflow_client.contract.inputs import EncodedImage, Input
from anchorflow_client.errors import InvalidAnswer, InvalidRequest

# Errors of reading fields of an unexpected shape.
UNREADABLE = (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError)


@dataclass(frozen=True)
class Payload:
    """The bytes of HTTP's body or of zenoh's payload."""

    body: bytes
    header_length: int | None = None
    """Bytes of JSON before the tensors; None without a header."""


class ServiceCodec(Protocol):
    """The service's half of a codec."""

    def decode_request(self, payload: Payload) -> AnchorRequest:
        """Read a request from untrusted bytes. Raises `InvalidRequest`, which names the field."""
        ...

    def encode_answer(self, batch: AnchorBatch) -> Payload:
        """Write an answer. Raises `ValueError` if a number is not finite."""
        ...


class Codec(ServiceCodec, Protocol):
    """One form of the contract on the wire."""

    @property
    def content_type(self) -> str:
        """The media type of this form."""
        ...

    @property
    def accept(self) -> str:
        """The Accept header that asks for answers in this form."""
        ...

    def encode_request(self, request: AnchorRequest) -> Payload:
        """Write a request, for a client."""
        ...

    def decode_answer(self, payload: Payload) -> AnchorBatch:
        """Read an answer from untrusted bytes, for a client. Raises `InvalidAnswer`."""
        ...


def answer_to(request: AnchorRequest, answer: AnchorBatch) -> AnchorBatch:
    """Return the answer. Raises `InvalidAnswer` if it has another id than the request."""
    if request.request_id is not None and answer.request_id != request.request_id:
        wanted, came = request.request_id, answer.request_id
        raise InvalidAnswer(f"request_id: expected the answer to {wanted}, got that to {came}")
    return answer


def request_fields(request: AnchorRequest) -> dict[str, Any]:
    """Return a request's fields, with numpy arrays; those left to the card are omitted."""
    fields = request.field_values()
    del fields["num_scenes"]
    batched, scenes = fields.pop("batched"), fields.pop("map_scenes")
    if scenes is not None:
        fields["cost_map"] = _map_fields(scenes.cost_map, batched=batched)
        for name in ("x_curr", "x_goal", "w_style"):
            array = getattr(scenes, name)
            fields[name] = array if batched else array[0]
    fields["sampler"] = request.sampler and request.sampler.given
    fields["refine"] = request.refine and request.refine.given
    for name in ("warm_start", "goal_tolerance", "obstacles", "kinematics"):
        fields[name] = None if fields[name] is None else _given(fields[name])
    fields["inputs"] = request.inputs or None
    fields["outputs"] = list(request.outputs) or None
    return {name: value for name, value in fields.items() if value is not None}


def answer_fields(batch: AnchorBatch) -> dict[str, Any]:
    """Return an answer's fields, with numpy arrays. Raises `ValueError` if one is not finite."""
    if not batch.is_finite:
        raise ValueError("the answer holds numbers that are not finite")
    absent = {"absent_inputs": ",".join(batch.absent_inputs)} if batch.absent_inputs else {}
    return dict(batch.arrays) | {
        "dt": batch.dt,
        "first_s": batch.first_s,
        "seed": batch.seed,
        "model": {**vars(batch.model)},
        "timing_ms": dict(batch.timing_ms),
        "request_id": batch.request_id,
        **absent,
        **({} if batch.reason is None else {"reason": batch.reason}),
    }


def answer_of(fields: Any, arrays: Mapping[str, Any] | None = None) -> AnchorBatch:
    """Read an answer from untrusted fields. Raises `InvalidAnswer`.

    arrays: if they are not among the fields; None: all lists among the fields but dt are arrays,
        and all objects of base64
    """
    try:
        if arrays is None:
            fields = {name: _unpacked(name, value) for name, value in fields.items()}
            arrays = {
                name: value
                for name, value in fields.items()
                if name != "dt" and isinstance(value, list | np.ndarray)
            }
        batch = _answer(fields, arrays)
        finite = batch.is_finite
    except (*UNREADABLE, InvalidRequest) as error:  # reading base64 raises it in both directions
        raise InvalidAnswer(f"not an answer of the contract: {error!r}") from error
    if not finite:
        raise InvalidAnswer("the answer holds numbers that are not finite")
    return batch


def _map_fields(cost_map: CostMap, *, batched: bool) -> dict[str, Any]:
    # A map that is broadcast over the batch has a stride of 0 and is sent once.
    shared = not batched or cost_map.data.strides[0] == 0
    data: NDArray[np.float32] = cost_map.data[0] if shared else cost_map.data
    fields: dict[str, Any] = {**vars(cost_map), "data": data}
    return {name: value for name, value in fields.items() if value is not None}


def _given(choice: WarmStart | GoalTolerance | Obstacles) -> dict[str, Any]:
    return {name: value for name, value in vars(choice).items() if value is not None}


def _answer(fields: Mapping[str, Any], arrays: Mapping[str, Any]) -> AnchorBatch:
    model = fields["model"]
    names = (model["name"], model["version"], model["sha256"])
    if not all(isinstance(name, str) for name in names):
        raise TypeError(f"expected strings in model, got {names!r:.200}")
    return AnchorBatch(
        arrays={name: _array(name, value) for name, value in arrays.items()},
        dt=_array("dt", fields["dt"]),
        first_s=float(fields.get("first_s", 0.0)),
        seed=int(fields["seed"]),
        model=ModelId(*names),
        timing_ms={str(stage): float(ms) for stage, ms in fields["timing_ms"].items()},
        request_id=fields.get("request_id"),
        reason=_sentence(fields.get("reason")),
        absent_inputs=tuple(name for name in fields.get("absent_inputs", "").split(",") if name),
    )


def _unpacked(name: str, value: Any) -> Any:
    """Return the array of an object of base64, and any other value as it is."""
    return array_of_bytes(value, name) if isinstance(value, dict) and "base64" in value else value


def _sentence(value: Any) -> str | None:
    if not isinstance(value, str | None):
        raise TypeError(f"expected a string or null in reason, got {value!r:.200}")
    return value


def _array(name: str, value: Any) -> NDArray[Any]:
    array = np.asarray(value)
    own = name in ARRAY_DTYPES or name == "dt"
    if array.dtype.kind not in "biufO" or (array.dtype.kind == "O" and own):
        raise TypeError(f"expected numbers in {name}, got {array.dtype}")
    if name == "routes" and array.dtype.kind not in "iu":
        raise TypeError(f"expected whole numbers in {name}, got {array.dtype}")
    return array


JSON_OF_BYTES = "application/json; arrays=base64"
"""The media type of an answer whose arrays are {"dtype", "shape", "base64"}."""
COMPACT = json.JSONEncoder(allow_nan=False, separators=(",", ":"))
"""For small headers; `json.dumps` makes an encoder each time."""


class JsonCodec:
    """Reads and writes the JSON of `POST /anchors`; subclasses may bring a faster JSON library.

    base64: write arrays as their bytes, {"dtype", "shape", "base64"}, and ask for answers so, which
        is several times faster than lists of numbers; both are read in either case
    """

    content_type = "application/json"

    def __init__(self, *, base64: bool = False) -> None:
        self._base64 = base64

    @property
    def accept(self) -> str:
        return JSON_OF_BYTES if self._base64 else self.content_type

    def encode_request(self, request: AnchorRequest) -> Payload:
        fields = request_fields(request)
        if "inputs" in fields:
            fields["inputs"] = {name: _input(value) for name, value in request.inputs.items()}
        return Payload(self._dump(fields))

    def decode_request(self, payload: Payload) -> AnchorRequest:
        return AnchorRequest.from_fields(self._load(payload.body))

    def encode_answer(self, batch: AnchorBatch) -> Payload:
        return Payload(self._dump({"reason": None, **answer_fields(batch)}))

    def decode_answer(self, payload: Payload) -> AnchorBatch:
        try:
            fields = self._load(payload.body)
        except InvalidRequest as error:  # reading raises it in both directions
            raise InvalidAnswer(f"not an answer of the contract: {error}") from error
        return answer_of(fields)

    def _dump(self, value: dict[str, Any]) -> bytes:
        written = as_bytes if self._base64 else _plain
        return json.dumps(
            value, default=written, allow_nan=False, ensure_ascii=False, separators=(",", ":")
        ).encode()

    def _load(self, body: bytes) -> Any:
        return parse(body)


def parse(body: bytes, field: str = "body") -> Any:
    """Parse JSON; NaN and Infinity are accepted, so that the check of a field can name them.

    field: the part of the message that holds the bytes, which `InvalidRequest` names
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
    return as_bytes(value)


def as_bytes(value: Any) -> Any:
    """Write numbers as {"dtype", "shape", "base64"}, and texts and what is empty as a list."""
    if not isinstance(value, np.ndarray) or value.dtype.kind == "O" or not value.size:
        return _plain(value)
    dtype = value.dtype.newbyteorder("=").name
    data = np.ascontiguousarray(value, DTYPES[dtype]).tobytes()
    return {"dtype": dtype, "shape": value.shape, "base64": base64.b64encode(data).decode()}


def _plain(value: Any) -> Any:
    """Convert numpy values, which `json` cannot write."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"cannot write a {type(value).__name__} as JSON")
