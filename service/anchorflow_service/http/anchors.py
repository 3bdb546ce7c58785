"""`POST /anchors`: bytes in, anchors out."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from functools import partial

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from anchorflow_client.codec import Codec, Payload
from anchorflow_client.contract import AnchorRequest, resolve_for_card
from anchorflow_client.errors import InvalidRequest
from anchorflow_service.http.body import read_body
from anchorflow_service.http.budget import Arrival
from anchorflow_service.http.engines import Engine, Engines
from anchorflow_service.http.limits import Limits
from anchorflow_service.http.openapi import ANCHORS_DOCUMENTATION
from anchorflow_service.http.orjson_codec import OrjsonCodec
from anchorflow_service.http.planning import PlanningQueue

CODECS: dict[str, Codec] = {codec.content_type: codec for codec in (OrjsonCodec(),)}
DEFAULT_CONTENT_TYPE = OrjsonCodec.content_type


def anchors_router(engines: Engines, queue: PlanningQueue, limits: Limits) -> APIRouter:
    """The route, over what the app holds."""
    router = APIRouter()

    @router.post("/anchors", tags=["anchors"], **ANCHORS_DOCUMENTATION)
    async def plan_anchors(request: Request) -> Response:
        """Trajectories from a state to a goal over a cost map: N a scene, scored and checked."""
        arrival = Arrival()
        body = await read_body(request, limits.max_body_bytes)
        codec = _codec_of(request)
        # Megabytes of numbers take a while to check: off the event loop with them.
        asked = await asyncio.to_thread(codec.decode_request, Payload(body))
        engine = engines.choose(asked.model)
        resolved = _with_id(resolve_for_card(asked, engine.card), request)
        arrival.check(resolved.budget_ms, "before planning")
        answer = await queue.run(partial(_plan, engine, resolved, codec, arrival))
        return Response(answer.body, media_type=codec.content_type)

    return router


def _plan(
    engine: Engine, request: AnchorRequest, codec: Codec, arrival: Arrival, queue_ms: float
) -> Payload:
    """What a worker does: plan, and write the answer too, which may hold millions of numbers."""
    arrival.check(request.budget_ms, "in the queue")
    batch = engine.plan(request)
    arrival.check(request.budget_ms, "after planning")
    timing_ms = {**batch.timing_ms, "queue": queue_ms, "total": arrival.elapsed_ms}
    return codec.encode_answer(replace(batch, timing_ms=timing_ms, request_id=request.request_id))


def _codec_of(request: Request) -> Codec:
    """The codec that the Content-Type names."""
    header = request.headers.get("content-type", DEFAULT_CONTENT_TYPE)
    content_type = header.partition(";")[0].strip().lower()
    if content_type not in CODECS:
        served = ", ".join(CODECS)
        message = f"expected a Content-Type of {served}, got {content_type!r}"
        raise InvalidRequest(f"{message}: not supported by this version", "Content-Type")
    return CODECS[content_type]


def _with_id(resolved: AnchorRequest, request: Request) -> AnchorRequest:
    """The id in the body rules; the one in the header, or a drawn one, stands in for it."""
    request.state.request_id = resolved.request_id or request.state.request_id
    return replace(resolved, request_id=request.state.request_id)
