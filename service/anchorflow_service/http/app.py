"""The application: routes, queue and error handling put together."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager

from fastapi import FastAPI

from anchorflow_service.http.anchors import anchors_router
from anchorflow_service.http.engines import Engine, Engines
from anchorflow_service.http.errors import install_error_handlers
from anchorflow_service.http.limits import Limits
from anchorflow_service.http.openapi import document
from anchorflow_service.http.planning import PlanningQueue
from anchorflow_service.http.request_id import RequestIds
from anchorflow_service.http.server import server_router, server_version


def create_app(
    engines: Mapping[str, Engine], *, default: str, limits: Limits | None = None
) -> FastAPI:
    """An ASGI application that serves the engines by model name.

    It is ready inside its lifespan, whose end waits for the engine calls that still run.

    Args:
        engines: by the name that a request's `model` gives.
        default: the name that stands in where a request gives none.
        limits: bounds on memory and on waiting.

    Raises:
        ValueError: `default` is not among the engines.
    """
    limits = limits or Limits()
    served = Engines(engines, default=default)
    queue = PlanningQueue(workers=limits.workers, max_waiting=limits.max_waiting)

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        with queue:
            yield

    app = FastAPI(
        title="AnchorFlow",
        version=server_version(),
        summary="Smooth trajectories worth trying, from a map, a state and a goal.",
        lifespan=lifespan,
        redirect_slashes=False,  # a redirect would not be the contract's error JSON
    )
    app.include_router(anchors_router(served, queue, limits))
    app.include_router(server_router(served, queue))
    app.add_middleware(RequestIds)
    install_error_handlers(app)
    document(app)
    return app
