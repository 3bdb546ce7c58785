"""Work that ends when the client who asked for it hangs up."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from contextlib import suppress
from typing import Any, TypeVar

from starlette.requests import Request
from starlette.responses import Response

Result = TypeVar("Result")

CLIENT_CLOSED_REQUEST = 499
"""What nginx calls it; no client reads it, logs and metrics do."""


class HungUp(Exception):
    """The client left before there was an answer."""


async def unless_hung_up(request: Request, work: Coroutine[Any, Any, Result]) -> Result:
    """What the work returns; it is cancelled where the client leaves first.

    The request's body must have been read: what comes after it is the client's leaving.

    Raises:
        HungUp: the client left.
    """
    working = asyncio.ensure_future(work)
    leaving = asyncio.ensure_future(_hang_up(request))
    try:
        await asyncio.wait({working, leaving}, return_when=asyncio.FIRST_COMPLETED)
        if not working.done():
            raise HungUp
        return working.result()
    finally:
        leaving.cancel()
        working.cancel()
        with suppress(asyncio.CancelledError):
            await leaving


def to_nobody() -> Response:
    """The answer to a client who has left."""
    return Response(status_code=CLIENT_CLOSED_REQUEST)


async def _hang_up(request: Request) -> None:
    while (await request.receive())["type"] != "http.disconnect":
        pass
