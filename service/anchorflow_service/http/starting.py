"""Answers while a service starts: its page, `/v2/health/live`, and `not_ready` for all else."""

from __future__ import annotations

import socket
import threading
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route, request_response

from anchorflow_client.errors import NotReady
from anchorflow_service.http.connections import SLOTS, ConnectionLimits, ConnectionSlots
from anchorflow_service.http.lifecycle import Draining, TlsFiles, uvicorn_config
from anchorflow_service.http.page import page_routes
from anchorflow_service.http.responses import error_response, json_response


@contextmanager
def answering_not_ready(
    listener: socket.socket,
    message: Callable[[], str],
    *,
    tls: TlsFiles | None = None,
    connections: ConnectionLimits | None = None,
) -> Iterator[None]:
    """Answer on a listening socket from a thread, until the block ends; the socket stays open.

    message: why the service is not ready yet, asked for each refusal
    """
    app = _app(message, connections or ConnectionLimits())
    server = uvicorn.Server(uvicorn_config(app, draining=Draining(drain_s=0.0), tls=tls))
    # uvicorn closes the sockets that it gets.
    options: dict[str, Any] = {"sockets": [listener.dup()]}
    thread = threading.Thread(target=server.run, kwargs=options, name="starting", daemon=True)
    thread.start()
    try:
        yield
    finally:
        server.should_exit = True
        thread.join()


def _app(message: Callable[[], str], connections: ConnectionLimits) -> Starlette:
    @asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[dict[str, Any]]:
        yield {SLOTS: ConnectionSlots(connections, [])}

    async def live(_: Request) -> Response:
        return json_response({"live": True})

    async def refuse(_: Request) -> Response:
        return error_response(NotReady(message()))

    app = Starlette(routes=[*page_routes(), Route("/v2/health/live", live)], lifespan=lifespan)
    app.router.default = request_response(refuse)
    return app
