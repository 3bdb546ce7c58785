"""The application: routes, error handling and the service behind them put together."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager

from fastapi import FastAPI
from starlette.middleware import Middleware

from anchorflow_service.http.anchors import anchors_router
from anchorflow_service.http.errors import install_error_handlers
from anchorflow_service.http.guard import Guard
from anchorflow_service.http.guard_documentation import document_guard
from anchorflow_service.http.health_alone import HealthAlone
from anchorflow_service.http.images import ignore_warnings_of_pillow
from anchorflow_service.http.leave_to_send import LeaveToSend
from anchorflow_service.http.metrics import metrics_router
from anchorflow_service.http.oip_models import models_router
from anchorflow_service.http.openapi import document
from anchorflow_service.http.page import page_router
from anchorflow_service.http.repository import repository_router
from anchorflow_service.http.request_id import RequestIds
from anchorflow_service.http.server import server_router, server_version
from anchorflow_service.http.tokens import TokenFile
from anchorflow_service.http.turns import Turns
from anchorflow_service.observability.exchanges import Exchanges, log_exchange
from anchorflow_service.observability.metrics import Metrics
from anchorflow_service.planning import PlanningService
from anchorflow_service.repository import Repository


def create_app(
    service: PlanningService,
    *,
    endpoints: Sequence[AbstractAsyncContextManager[object]] = (),
    tokens: TokenFile | None = None,
    repository: Repository | None = None,
    middleware: Sequence[Middleware] = (),
) -> FastAPI:
    """An ASGI application over the service.

    It is ready inside its lifespan, which opens the service, and whose end waits for the engine
    calls that still run.

    Args:
        service: what answers; no other application may open it.
        endpoints: other transports of the same service, open as long as it is.
        tokens: who may ask; None: everybody.
        repository: bundles that may be loaded; None: there are no routes to do so.
        middleware: around all routes, refusals included; each sees the request's id.
    """
    metrics = Metrics(service)
    listeners = [metrics.exchanged, log_exchange]

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        ignore_warnings_of_pillow()
        async with AsyncExitStack() as stack:
            stack.enter_context(service)
            for endpoint in endpoints:
                await stack.enter_async_context(endpoint)
            yield

    app = FastAPI(
        title="AnchorFlow",
        version=server_version(),
        summary="Smooth trajectories worth trying, from a map, a state and a goal.",
        lifespan=lifespan,
        redirect_slashes=False,  # a redirect would not be the contract's error JSON
        docs_url=None,  # FastAPI's pages load their scripts from elsewhere, and name their versions
        redoc_url=None,
        # From the outside in.
        middleware=[
            Middleware(LeaveToSend),
            Middleware(Turns),
            Middleware(RequestIds),
            *middleware,
            Middleware(Exchanges, listeners=listeners),
            Middleware(HealthAlone),
            *([] if tokens is None else [Middleware(Guard, tokens=tokens)]),
        ],
    )
    app.state.exchange_listeners = listeners
    app.include_router(anchors_router(service))
    app.include_router(server_router(service))
    app.include_router(models_router(service))
    if repository is not None:
        app.include_router(repository_router(repository))
    app.include_router(page_router(service))
    app.include_router(metrics_router(metrics))
    install_error_handlers(app)
    document(app)
    if tokens is not None:
        document_guard(app)
    return app
