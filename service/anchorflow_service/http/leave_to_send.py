"""Callers who wait for leave to send a body, and are answered without it."""

from __future__ import annotations

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send


def waits_for_leave(headers: Headers) -> bool:
    """Whether a request's body comes only after a `100 Continue`."""
    return headers.get("expect", "").lower() == "100-continue"


class LeaveToSend:
    """Middleware: an answer in place of that leave says `Connection: close`.

    Its caller may send the body all the same or not, so that nobody could tell it from the next
    request (RFC 9110, 10.1.1). The leave is given when the body is first asked for.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on."""
        if scope["type"] != "http" or not waits_for_leave(Headers(scope=scope)):
            await self._app(scope, receive, send)
            return
        has_leave = False

        async def receive_with_leave() -> Message:
            nonlocal has_leave
            has_leave = True
            return await receive()

        async def send_without_leave(message: Message) -> None:
            if message["type"] == "http.response.start" and not has_leave:
                MutableHeaders(scope=message)["Connection"] = "close"
            await send(message)

        await self._app(scope, receive_with_leave, send_without_leave)
