"""HTTP exchanges: reading a request's body up to a limit, and the outermost middleware.

The middleware sets a request id and reports every exchange to listeners.
"""

from __future__ import annotations

import asyncio
import logging
import time
import uuid
from collections.abc import Sequence
from contextlib import suppress
from urllib.parse import quote

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import ClientDisconnect, Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from anchorflow_client.contract.checks import text
from anchorflow_client.errors import InvalidRequest, TooLarge
from anchorflow_service.http.responses import error_response
from anchorflow_service.observability.logs import (
    CLIENT_DISCONNECTED,
    UNROUTED,
    Exchange,
    Listener,
)
from anchorflow_service.planning import internal_error

# Most clients send the whole body before they read the answer; if the connection closed in between,
# they would see a reset instead of the reason. So the rest is received and discarded.
MAX_DISCARDED_BYTES = 256 * 2**20
MAX_DISCARDING_S = 10.0


async def read_body(request: Request, max_bytes: int) -> bytes:
    """Read the whole body. Raises `InvalidRequest` or `TooLarge`.

    A compressed one is refused, as a small body could unpack to a huge one. The rest of one that
    is too large, by its Content-Length or as it comes, is discarded.
    """
    encoding = request.headers.get("content-encoding", "identity")
    if encoding.lower() != "identity":
        await discard_body(request)
        raise InvalidRequest(f"expected a body as it is, got {encoding[:40]!r}", "Content-Encoding")
    declared = request.headers.get("content-length", "")
    if declared.isdecimal() and int(declared) > max_bytes:
        await discard_body(request)
        raise _too_large(max_bytes, f"{int(declared)}")
    chunks, size = [], 0
    async for chunk in request.stream():
        size += len(chunk)
        if size > max_bytes:
            chunks.clear()
            await discard_body(request)
            raise _too_large(max_bytes, "more")
        chunks.append(chunk)
    return b"".join(chunks)


async def discard_body(request: Request) -> None:
    """Receive and discard the rest of a body, within bounds of size and time."""

    async def take() -> None:
        size = 0
        async for chunk in request.stream():
            size += len(chunk)
            if size > MAX_DISCARDED_BYTES:
                return

    with suppress(asyncio.TimeoutError, ClientDisconnect):
        await asyncio.wait_for(take(), MAX_DISCARDING_S)


def _too_large(max_bytes: int, came: str) -> TooLarge:
    return TooLarge(f"expected a body of at most {max_bytes} bytes, got {came}", "body")


REQUEST_ID = "X-Request-Id"

logger = logging.getLogger(__name__)


class Exchanges:
    """Middleware: sets a request's id, answers unexpected exceptions, and calls the listeners.

    The id is the caller's or a random one. It is kept in the request's `state.request_id`, which an
    endpoint may change, and sent in the `X-Request-Id` header of every response.
    """

    def __init__(self, app: ASGIApp, *, listeners: Sequence[Listener]) -> None:
        self._app = app
        self._listeners = listeners

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on; turn an unexpected exception into `internal`."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        began = time.perf_counter()
        state = scope.setdefault("state", {})
        state["request_id"] = _requested_id(Headers(scope=scope)) or uuid.uuid4().hex
        status = None

        async def send_with_id(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                MutableHeaders(scope=message)[REQUEST_ID] = state["request_id"]
            await send(message)

        try:
            await self._app(scope, receive, send_with_id)
        except Exception:
            request_id = state["request_id"]
            logger.exception("request %s failed", request_id, extra={"request_id": request_id})
            if status is not None:
                status = 500
                raise
            await error_response(internal_error(request_id))(scope, receive, send_with_id)
        finally:
            exchange = Exchange(
                method=scope["method"],
                path=quote(scope["path"]),
                route=getattr(scope.get("route"), "path", UNROUTED),
                status=status or CLIENT_DISCONNECTED,
                seconds=time.perf_counter() - began,
                request_id=state["request_id"],
                caller=state.get("caller"),
            )
            for listener in self._listeners:
                listener(exchange)


def _requested_id(headers: Headers) -> str | None:
    """Return the caller's own id, if it can be echoed."""
    header = headers.get(REQUEST_ID)
    try:
        return header and text(header, REQUEST_ID)
    except InvalidRequest:
        return None
