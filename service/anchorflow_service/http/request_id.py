"""One id a request: in the log, in the answer, and in the X-Request-Id header of every answer."""

from __future__ import annotations

import logging
import uuid

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from anchorflow_client.contract.checks import text
from anchorflow_client.errors import InvalidRequest
from anchorflow_service.http.errors import error_answer
from anchorflow_service.planning import internal_error

HEADER = "X-Request-Id"

logger = logging.getLogger(__name__)


class RequestIds:
    """Middleware: takes the caller's id or draws one, and logs what nobody caught under it.

    The id stands in the request's `state.request_id`, where an endpoint may put another.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on; turn an unexpected exception into `internal`."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        state = scope.setdefault("state", {})
        state["request_id"] = _asked_id(Headers(scope=scope).get(HEADER)) or uuid.uuid4().hex
        started = False

        async def send_with_id(message: Message) -> None:
            nonlocal started
            if message["type"] == "http.response.start":
                started = True
                MutableHeaders(scope=message)[HEADER] = state["request_id"]
            await send(message)

        try:
            await self._app(scope, receive, send_with_id)
        except Exception:
            request_id = state["request_id"]
            logger.exception("request %s failed", request_id, extra={"request_id": request_id})
            if started:
                raise
            failed = error_answer(internal_error(request_id))
            await failed(scope, receive, send_with_id)


def _asked_id(header: str | None) -> str | None:
    """The caller's own id, where it is one that can be echoed."""
    try:
        return header and text(header, HEADER)
    except InvalidRequest:
        return None
