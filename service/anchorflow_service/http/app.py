"""The application: routes, middleware, error handling and the service behind them."""

from __future__ import annotations

import ctypes
from collections.abc import AsyncIterator, Sequence
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager
from typing import Any

from fastapi import FastAPI
from starlette.middleware import Middleware

from anchorflow_service.http.anchors import anchors_router
from anchorflow_service.http.api_page import api_router
from anchorflow_service.http.connections import (
    SLOTS,
    ConnectionLimits,
    ConnectionSlots,
    OverloadGuard,
)
from anchorflow_service.http.exchanges import Exchanges
from anchorflow_service.http.oip_models import models_router
from anchorflow_service.http.openapi import document
from anchorflow_service.http.orjson_codec import ignore_warnings_of_pillow
from anchorflow_service.http.page import page_router
from anchorflow_service.http.responses import install_error_handlers
from anchorflow_service.http.routes import (
    metrics_router,
    repository_router,
    server_router,
    server_version,
)
from anchorflow_service.http.tokens import TokenFile, TokenGuard, document_tokens
from anchorflow_service.observability.logs import log_exchange
from anchorflow_service.observability.metrics import Metrics
from anchorflow_service.planning import PlanningService
from anchorflow_service.repository import Repository

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of glibc's mallopt(3)
KEPT_BYTES = 1 << 27


def create_app(
    service: PlanningService,
    *,
    connections: ConnectionLimits | None = None,
    endpoints: Sequence[AbstractAsyncContextManager[object]] = (),
    tokens: TokenFile | None = None,
    repository: Repository | None = None,
    middleware: Sequence[Middleware] = (),
) -> FastAPI:
    """Make an ASGI application for the service.

    Its lifespan opens the service; its end waits for running engine calls.

    Args:
        service: plans; no other application may open it.
        connections: bounds under `uvicorn_config`; other servers have their own.
        endpoints: entered in the lifespan, such as another transport of the same service.
        tokens: who may send requests; None: no token is required.
        repository: bundles that may be loaded; None: there are no routes for it.
        middleware: added around all routes, inside the one that sets the request's id.
    """
    metrics = Metrics(service)
    listeners = [metrics.exchanged, log_exchange]

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[dict[str, Any]]:
        ignore_warnings_of_pillow()
        _keep_freed_memory()
        async with AsyncExitStack() as stack:
            stack.enter_context(service)
            for endpoint in endpoints:
                await stack.enter_async_context(endpoint)
            yield {SLOTS: ConnectionSlots(connections or ConnectionLimits(), listeners)}

    app = FastAPI(
        title="AnchorFlow",
        version=server_version(),
        summary="Smooth trajectories worth trying, from a map, a state and a goal.",
        lifespan=lifespan,
        redirect_slashes=False,  # a redirect would not be the contract's error JSON
        docs_url=None,  # FastAPI's page loads its scripts from elsewhere; `api_page` has another
        redoc_url=None,
        # The first is outermost.
        middleware=[
            Middleware(Exchanges, listeners=listeners),
            Middleware(OverloadGuard),
            *middleware,
            *([] if tokens is None else [Middleware(TokenGuard, tokens=tokens)]),
        ],
    )
    app.include_router(anchors_router(service))
    app.include_router(server_router(service))
    app.include_router(models_router(service))
    if repository is not None:
        app.include_router(repository_router(repository))
    app.include_router(page_router(service))
    app.include_router(api_router())
    app.include_router(metrics_router(metrics))
    install_error_handlers(app)
    document(app)
    if tokens is not None:
        document_tokens(app)
    return app


def _keep_freed_memory() -> None:
    """Let glibc keep up to KEPT_BYTES that were freed; other C libraries are left as they are.

    By default it returns large arrays to the system, so that each request waits for a thousand
    page faults: a tenth of the time of a plan with a footprint.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):
        return
    mallopt(_TRIM_THRESHOLD, KEPT_BYTES)
    mallopt(_MMAP_THRESHOLD, KEPT_BYTES)
