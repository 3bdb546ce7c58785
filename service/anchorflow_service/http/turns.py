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
        self._line = asyncio.Lock()
        self._is_taken = False
        """Whether a request has begun in this pass."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on when its turn has come, the first that came first."""
        if scope["type"] == "http" and not scope["path"].startswith(HEALTH):
            if self._is_taken or self._line.locked():
                async with self._line:
                    while self._is_taken:
                        await asyncio.sleep(0)
                    self._take()
            else:
                self._take()
        await self._app(scope, receive, send)

    def _take(self) -> None:
        self._is_taken = True
        asyncio.get_running_loop().call_soon(self._end_pass)

    def _end_pass(self) -> None:
        self._is_taken = False
