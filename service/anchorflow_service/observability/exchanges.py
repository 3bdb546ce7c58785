"""Every HTTP exchange, once it is over: counted, and a line of the log each."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from urllib.parse import quote

from starlette.types import ASGIApp, Message, Receive, Scope, Send

OTHER = "other"
"""The route of what no route matched."""
BROKEN_OFF = 499
"""In place of a status where the caller left before there was one, as nginx has it."""
REFUSED = "refused"
"""In a request's state: the status with which its connection refused it in mid-body."""
FAILED = 500
"""What an exception is answered with, further out."""

logger = logging.getLogger("anchorflow_service.access")


@dataclass(frozen=True)
class Exchange:
    """A request and its answer's head; method and path are "-" where there was no request."""

    method: str
    path: str
    """Percent-encoded: what a caller sends cannot begin a line of the log."""
    route: str
    """The template that the path matched: /v2/models/{name}."""
    status: int
    seconds: float
    request_id: str
    caller: str | None
    """Name of the token, where tokens are asked for."""


Listener = Callable[[Exchange], None]


class Exchanges:
    """Middleware: tells the listeners of every exchange."""

    def __init__(self, app: ASGIApp, *, listeners: Sequence[Listener]) -> None:
        self._app = app
        self._listeners = listeners

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, and note what becomes of it."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        began, status = time.perf_counter(), BROKEN_OFF

        async def send_noted(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
            await send(message)

        try:
            await self._app(scope, receive, send_noted)
        except Exception:
            status = FAILED
            raise
        finally:
            exchange = _exchange(scope, status, time.perf_counter() - began)
            for listener in self._listeners:
                listener(exchange)


def log_exchange(exchange: Exchange) -> None:
    """One line, at level info."""
    if not logger.isEnabledFor(logging.INFO):
        return
    logger.info(
        "%s %s %d in %.1f ms",
        exchange.method,
        exchange.path,
        exchange.status,
        exchange.seconds * 1e3,
        extra={
            "request_id": exchange.request_id,
            "method": exchange.method,
            "path": exchange.path,
            "status": exchange.status,
            "ms": round(exchange.seconds * 1e3, 3),
            "caller": exchange.caller,
        },
    )


def _exchange(scope: Scope, status: int, seconds: float) -> Exchange:
    state = scope.get("state", {})
    return Exchange(
        method=scope["method"],
        path=quote(scope["path"]),
        route=getattr(scope.get("route"), "path", OTHER),
        status=state.get(REFUSED, status),
        seconds=seconds,
        request_id=state.get("request_id", ""),
        caller=state.get("caller"),
    )
