"""A connection in the reserve is told of the service's health alone."""

from __future__ import annotations

from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from anchorflow_client.errors import Overloaded
from anchorflow_service.http.body import discard_body
from anchorflow_service.http.connections import RESERVED
from anchorflow_service.http.errors import error_answer
from anchorflow_service.http.guard import HEALTH


class HealthAlone:
    """Middleware: to a connection in the reserve health is answered, all else is `overloaded`."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, or refuse it."""
        is_reserved = scope["type"] == "http" and scope.get("state", {}).get(RESERVED)
        if not is_reserved or scope["path"].startswith(HEALTH):
            await self._app(scope, receive, send)
            return
        await discard_body(Request(scope, receive))
        error = Overloaded("too many connections; try again in 1 s", retry_after_s=1)
        await error_answer(error, {"Connection": "close"})(scope, receive, send)
