"""`POST /page/flow`: the states that a solver visits, for the page to show how anchors come about.

No part of the contract: the page and the service come from one package and change together.
"""

from __future__ import annotations

from functools import partial
from typing import Protocol, runtime_checkable

import numpy as np
from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from anchorflow_client.codec import Payload
from anchorflow_client.contract import OdeSpec, ResolvedRequest, resolve_for_card
from anchorflow_client.errors import InvalidRequest
from anchorflow_service.engine.samplers.ode import FlowStates
from anchorflow_service.http.answers import json_answer
from anchorflow_service.http.body import read_body
from anchorflow_service.http.hang_up import HungUp, to_nobody, unless_hung_up
from anchorflow_service.http.orjson_codec import OrjsonCodec
from anchorflow_service.planning import Arrival, PlanningService

MAX_ANCHORS = 64
MAX_STEPS = 32
DIGITS = 3
"""Of a position in m: a screen shows no more."""


@runtime_checkable
class FlowEngine(Protocol):
    """An engine whose anchors come out of a flow that can be watched."""

    def flow_states(self, request: ResolvedRequest, /) -> FlowStates:
        """The states of a request's only scene at the times of its schedule. Blocks."""
        ...


def flow_replay_router(service: PlanningService) -> APIRouter:
    """The route, over the service and through its queue."""
    router = APIRouter()

    @router.post("/page/flow")
    async def flow(request: Request) -> Response:
        """{times [K], positions [K,N,T,2]} of a request as `POST /anchors` takes it in JSON."""
        arrival = service.arrival()
        body = await read_body(request, service.limits.max_body_bytes)
        try:
            return await unless_hung_up(request, _replay(service, Payload(body), arrival))
        except HungUp:
            return to_nobody()

    return router


async def _replay(service: PlanningService, payload: Payload, arrival: Arrival) -> Response:
    with service.queue.place():
        engine, request = await service.reading(payload, partial(_read, service, payload))
        return await service.queue.run(
            lambda _: _answer(engine.flow_states(request)),
            arrival=arrival,
            budget_ms=request.budget_ms,
        )


def _read(service: PlanningService, payload: Payload) -> tuple[FlowEngine, ResolvedRequest]:
    """What is asked, of whom. Raises `InvalidRequest`."""
    asked = OrjsonCodec().decode_request(payload)
    engine = service.engines.choose(asked.model)
    if not isinstance(engine, FlowEngine):
        raise InvalidRequest(f"expected a model with a flow, got {engine.card.name}", "model")
    request = resolve_for_card(asked, engine.card)
    _check_size(request)
    return engine, request


def _check_size(request: ResolvedRequest) -> None:
    """Every state of every anchor is sent, so there may not be many."""
    if request.batched:
        raise InvalidRequest(f"expected one scene, got {request.num_scenes}", "x_curr")
    if request.num_samples > MAX_ANCHORS:
        got = f"expected at most {MAX_ANCHORS} in a replay, got {request.num_samples}"
        raise InvalidRequest(got, "num_samples")
    steps = len(request.sampler.schedule) - 1 if isinstance(request.sampler, OdeSpec) else 0
    if steps > MAX_STEPS:
        raise InvalidRequest(
            f"expected at most {MAX_STEPS} steps in a replay, got {steps}", "sampler.schedule"
        )


def _answer(states: FlowStates) -> Response:
    positions = np.round(states.positions[..., :2].astype(np.float64), DIGITS)
    return json_answer({"times": states.times, "positions": positions})
