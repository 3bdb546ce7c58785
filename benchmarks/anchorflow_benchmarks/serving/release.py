"""How soon an engine is free when nobody waits for its answer any more."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import replace
from random import Random
from time import perf_counter

from anchorflow_benchmarks.report import ResultTable, Row
from anchorflow_benchmarks.turns import p50
from anchorflow_client.codec import Payload
from anchorflow_client.contract import AnchorRequest, SamplerChoice, resolve_for_card
from anchorflow_client.errors import DeadlineExceeded, Superseded
from anchorflow_client.oip_codec import OipCodec
from anchorflow_service.engine import Engine
from anchorflow_service.planning import Call, PlanningService, ServiceLimits

CODEC = OipCodec()
EARLIEST, LATEST = 0.2, 0.7  # of a request's time, when it is given up

Give = Callable[[PlanningService, AnchorRequest, float], Awaitable[float]]
"""Asks, gives the request up after so many seconds, and tells when that was."""


def release_table(engine: Engine, request: AnchorRequest, *, rounds: int) -> ResultTable:
    """Time from giving a request up to the next job on its lane, over the time of a step."""
    resolved = resolve_for_card(request, engine.card)
    steps = len((request.sampler or SamplerChoice()).over(engine.card.ode).schedule) - 1
    timings = [engine.plan(resolved, threads=1).timing_ms for _ in range(3)]
    whole_s = p50([timing["total"] for timing in timings]) / 1e3
    step_ms = p50([timing["sample"] for timing in timings]) / steps
    service = PlanningService({"it": engine}, default="it", limits=ServiceLimits(threads=1))
    draw = Random(0)
    with service:
        rows: list[Row] = []
        for way, give in GIVES.items():
            times = [
                asyncio.run(
                    _released(service, request, give, draw.uniform(EARLIEST, LATEST) * whole_s)
                )
                for _ in range(rounds)
            ]
            rows.append(
                {
                    "given up by": way,
                    "step ms": step_ms,
                    "free after p50 ms": p50(times),
                    "free after max ms": max(times),
                    "max, steps": max(times) / step_ms,
                }
            )
    note = (
        f"{rounds} requests each, {steps} steps, one thread; the whole takes {whole_s * 1e3:.0f} ms"
    )
    return ResultTable("Release", rows, note)


async def _released(
    service: PlanningService, request: AnchorRequest, give: Give, after_s: float
) -> float:
    """ms from giving up to the moment when the lane takes another job."""
    given_up = await give(service, request, after_s)
    return (await service.queue.run(lambda _: perf_counter()) - given_up) * 1e3


def _ask(service: PlanningService, request: AnchorRequest) -> asyncio.Future[Payload]:
    call = Call(CODEC.encode_request(request), CODEC, service.arrival(), "release")
    return asyncio.ensure_future(service.answer(call))


async def _hang_up(service: PlanningService, request: AnchorRequest, after_s: float) -> float:
    asked = _ask(service, request)
    await asyncio.sleep(after_s)
    given_up = perf_counter()
    asked.cancel()
    with suppress(asyncio.CancelledError):
        await asked
    return given_up


async def _run_out(service: PlanningService, request: AnchorRequest, after_s: float) -> float:
    start = perf_counter()
    with suppress(DeadlineExceeded):
        await _ask(service, replace(request, budget_ms=after_s * 1e3))
    return start + after_s


async def _supersede(service: PlanningService, request: AnchorRequest, after_s: float) -> float:
    mine = replace(request, robot_id="robot")
    older = _ask(service, mine)
    await asyncio.sleep(after_s)
    given_up = perf_counter()
    newer = _ask(service, mine)
    with suppress(Superseded):
        await older
    newer.cancel()
    with suppress(asyncio.CancelledError):
        await newer
    return given_up


GIVES: dict[str, Give] = {
    "hanging up": _hang_up,
    "its budget": _run_out,
    "a newer request": _supersede,
}
