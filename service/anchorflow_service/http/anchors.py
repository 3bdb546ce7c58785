"""`POST /anchors`: bytes in, anchors out."""

from __future__ import annotations

import re

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from anchorflow_client.codec import Codec, Payload
from anchorflow_client.errors import InvalidRequest
from anchorflow_client.http.answer_parser import whole_number
from anchorflow_client.oip_codec import OipCodec
from anchorflow_service.http.exchanges import read_body
from anchorflow_service.http.openapi import ANCHORS_DOCUMENTATION, HEADER_LENGTH
from anchorflow_service.http.orjson_codec import OrjsonCodec
from anchorflow_service.http.responses import PlainRoute, cancel_on_disconnect
from anchorflow_service.planning import Call, PlanningService

BINARY = OipCodec()
CODECS: dict[str, Codec] = {codec.content_type: codec for codec in (OrjsonCodec(), BINARY)}
JSON = OrjsonCodec.content_type
_ARRAYS = re.compile(r"application/json\s*;(?:[^,]*;)?\s*arrays=([^,;]*)", re.IGNORECASE)
"""In an Accept header: how JSON writes arrays, by default as lists."""
JSON_FORMS: dict[str, Codec] = {"": CODECS[JSON], "base64": OrjsonCodec(base64=True)}


def anchors_router(service: PlanningService) -> APIRouter:
    router = APIRouter(route_class=PlainRoute)

    @router.post("/anchors", tags=["anchors"], **ANCHORS_DOCUMENTATION)
    async def plan_anchors(request: Request) -> Response:
        """Anchors over a cost map, or for the inputs that a model's card lists: N a scene.

        With `Accept: application/json; arrays=base64` every array of the answer is an object of its
        `dtype`, `shape` and bytes in `base64`, row-major and little-endian.
        """
        arrival = service.arrival()
        body = await read_body(request, service.limits.max_body_bytes)
        length, codec = header_length(request), _codec_of(request)
        payload = Payload(body, length if codec is BINARY else None)
        call = Call(payload, codec, arrival, request.state.request_id)
        return await answer_to(call, request, service)

    return router


async def answer_to(call: Call, request: Request, service: PlanningService) -> Response:
    """Return the answer, encoded by the call's codec. Raises `ClientDisconnect`."""
    try:
        answer = await cancel_on_disconnect(request, service.answer(call))
    finally:  # the log and the header of an error carry the request's own id too
        request.state.request_id = call.request_id
    length = answer.header_length
    headers = {} if length is None else {HEADER_LENGTH: str(length)}
    media_type = JSON if length is None else OipCodec.content_type
    return Response(answer.body, headers=headers, media_type=media_type)


def header_length(request: Request) -> int | None:
    """Return the length of the JSON header, which only the binary form has."""
    value = request.headers.get(HEADER_LENGTH)
    length = whole_number(value)
    if value is not None and not length:
        raise InvalidRequest(f"expected a number of bytes, got {value[:40]!r}", HEADER_LENGTH)
    return length


def _codec_of(request: Request) -> Codec:
    header = request.headers.get("content-type", JSON)
    content_type = header.partition(";")[0].strip().lower()
    if content_type not in CODECS:
        served = " or ".join(CODECS)
        message = f"expected a Content-Type of {served}, got {content_type!r}"
        raise InvalidRequest(f"{message}: not supported by this version", "Content-Type")
    return CODECS[content_type] if content_type != JSON else _json_of(request)


def _json_of(request: Request) -> Codec:
    """Return the codec of JSON whose arrays have the form that the Accept header asks for."""
    found = _ARRAYS.search(request.headers.get("accept", ""))
    asked = found[1].strip().lower() if found else ""
    if asked not in JSON_FORMS:
        raise InvalidRequest(f"expected {JSON}; arrays=base64, got arrays={asked[:40]}", "Accept")
    return JSON_FORMS[asked]
