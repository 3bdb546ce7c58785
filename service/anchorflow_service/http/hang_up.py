"""Work that ends when the client who asked for it hangs up."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Coroutine
from typing import Any, TypeVar

from starlette.requests import Request
from starlette.responses import Response

from anchorflow_service.observability.exchanges import BROKEN_OFF

Result = TypeVar("Result")


class HungUp(Exception):
    """The client left before there was an answer."""


async def unless_hung_up(request: Request, work: Coroutine[Any, Any, Result]) -> Result:
    """What the work returns; it is cancelled where the client leaves first.

    The request's body must have been read: what comes after it is the client's leaving. The work is
    done by the task that asks, which costs fewer passes of the event loop than one of its own.

    Raises:
        HungUp: the client left.
    """
    working = asyncio.current_task()
    assert working is not None
    was_left = is_over = False

    def leave(leaving: asyncio.Future[None]) -> None:
        nonlocal was_left
        # Of work that is over, what the task does next would be cancelled.
        if not is_over and not leaving.cancelled():
            was_left = True
            working.cancel()

    leaving = asyncio.ensure_future(_hang_up(request))
    leaving.add_done_callback(leave)
    try:
        return await work
    except asyncio.CancelledError:
        if not was_left:
            raise
        if sys.version_info >= (3, 11):
            working.uncancel()
        raise HungUp from None
    finally:
        is_over = True
        leaving.cancel()


def to_nobody() -> Response:
    """The answer to a client who has left."""
    return Response(status_code=BROKEN_OFF)


async def _hang_up(request: Request) -> None:
    while (await request.receive())["type"] != "http.disconnect":
        pass
