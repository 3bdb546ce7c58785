"""The page at `/`: its files, and `POST /page/flow`, the states of a solver for its replay.

All files are read when the routes are made, so no caller chooses a path. The replay is no part of
the contract: page and service ship in one package and change together.
"""

from __future__ import annotations

import gzip
import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from anchorflow_client.codec import Payload
from anchorflow_client.contract import OdeSpec, ResolvedRequest, resolve_for_card
from anchorflow_client.errors import InvalidRequest
from anchorflow_service.engine.samplers.ode import FlowStates
from anchorflow_service.http.exchanges import read_body
from anchorflow_service.http.orjson_codec import OrjsonCodec
from anchorflow_service.http.responses import cancel_on_disconnect, json_response
from anchorflow_service.planning import Arrival, PlanningService

FOLDER = Path(__file__).parents[1] / "page"
INDEX = "index.html"
MAX_REPLAYED_ANCHORS = 64
MAX_REPLAYED_STEPS = 32
DIGITS = 3
"""Decimals of a position in m; a screen shows no more."""

CONTENT_TYPES = {
    ".css": "text/css; charset=utf-8",
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".json": "application/json",
    ".svg": "image/svg+xml",
}
HEADERS = {
    # No scripts or styles of other origins or inline, and no frame around the page.
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    # The browser keeps the files but revalidates them, so that modules of two versions never mix.
    "Cache-Control": "no-cache",
    "Vary": "Accept-Encoding",
}


@dataclass(frozen=True)
class PageFile:
    """A file of the page, ready to send."""

    content_type: str
    body: bytes
    zipped: bytes
    tag: str
    """The ETag; weak, because it stands for the file in either encoding."""

    @classmethod
    def read(cls, path: Path) -> PageFile:
        body = path.read_bytes()
        return cls(
            content_type=CONTENT_TYPES[path.suffix],
            body=body,
            zipped=gzip.compress(body, mtime=0),
            tag=f'W/"{hashlib.sha256(body).hexdigest()[:20]}"',
        )

    async def respond(self, request: Request) -> Response:
        """Send the file, or 304 if the browser has it."""
        headers = {**HEADERS, "ETag": self.tag}
        if self.tag in request.headers.get("if-none-match", ""):
            return Response(status_code=304, headers=headers)
        zips = "gzip" in request.headers.get("accept-encoding", "")
        if zips:
            headers["Content-Encoding"] = "gzip"
        body = self.zipped if zips else self.body
        return Response(body, headers=headers, media_type=self.content_type)


@runtime_checkable
class FlowEngine(Protocol):
    """An engine whose sampler solves a flow, so that its states can be shown."""

    def flow_states(self, request: ResolvedRequest, /) -> FlowStates:
        """Return the states of a request's only scene at the times of its schedule. Blocks."""
        ...


def page_router(service: PlanningService) -> APIRouter:
    """Return `/`, `/page/…` and `POST /page/flow`."""
    router = APIRouter(include_in_schema=False)
    router.routes.extend(page_routes())

    @router.post("/page/flow")
    async def flow(request: Request) -> Response:
        """{times [K], positions [K,N,T,2]} of a request as `POST /anchors` takes it in JSON."""
        arrival = service.arrival()
        body = await read_body(request, service.limits.max_body_bytes)
        return await cancel_on_disconnect(request, _replay(service, Payload(body), arrival))

    return router


@cache
def page_routes() -> tuple[Route, ...]:
    return tuple(Route(url, PageFile.read(path).respond) for url, path in page_files())


def page_files() -> Iterator[tuple[str, Path]]:
    """Yield the URL and the path of every file of the page."""
    yield "/", FOLDER / INDEX
    for path in sorted(FOLDER.rglob("*.*")):
        if path.suffix in CONTENT_TYPES and path.name != INDEX:
            yield f"/page/{path.relative_to(FOLDER).as_posix()}", path


async def _replay(service: PlanningService, payload: Payload, arrival: Arrival) -> Response:
    with service.queue.place():
        engine, request = await service.reading(payload, partial(_read, service, payload))
        return await service.queue.run(
            lambda _: _flow_response(engine.flow_states(request)),
            arrival=arrival,
            budget_ms=request.budget_ms,
        )


def _read(service: PlanningService, payload: Payload) -> tuple[FlowEngine, ResolvedRequest]:
    """Decode the request and choose its engine. Raises `InvalidRequest`."""
    asked = OrjsonCodec().decode_request(payload)
    engine = service.engines.choose(asked.model)
    if not isinstance(engine, FlowEngine):
        raise InvalidRequest(f"expected a model with a flow, got {engine.card.name}", "model")
    request = resolve_for_card(asked, engine.card)
    _check_size(request)
    return engine, request


def _check_size(request: ResolvedRequest) -> None:
    """Bound the states that are sent, one for every step of every anchor."""
    if request.batched:
        raise InvalidRequest(f"expected one scene, got {request.num_scenes}", "x_curr")
    if request.num_samples > MAX_REPLAYED_ANCHORS:
        got = f"expected at most {MAX_REPLAYED_ANCHORS} in a replay, got {request.num_samples}"
        raise InvalidRequest(got, "num_samples")
    steps = len(request.sampler.schedule) - 1 if isinstance(request.sampler, OdeSpec) else 0
    if steps > MAX_REPLAYED_STEPS:
        got = f"expected at most {MAX_REPLAYED_STEPS} steps in a replay, got {steps}"
        raise InvalidRequest(got, "sampler.schedule")


def _flow_response(states: FlowStates) -> Response:
    positions = np.round(states.positions[..., :2].astype(np.float64), DIGITS)
    return json_response({"times": states.times, "positions": positions})
