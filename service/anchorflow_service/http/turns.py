"""One request begins a pass of the event loop, so that a crowd leaves others their turn."""

from __future__ import annotations

import asyncio

from starlette.types import ASGIApp, Receive, Scope, Send

from anchorflow_service.http.guard import HEALTH


class Turns:
    """Middleware: requests that come at once begin one after another; health never waits.

    What a request costs before it first waits, reading its body above all, keeps the event loop
    from everybody else. Of 64 that came together all would begin in one pass, and whoever asked for
    health meanwhile would wait for the last of them.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
        self._turn = asyncio.Lock()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on when its turn has come, the first that came first."""
        if scope["type"] == "http" and not scope["path"].startswith(HEALTH):
            async with self._turn:
                await asyncio.sleep(0)
        await self._app(scope, receive, send)
