"""Requests that come at once begin one a pass of the event loop, and health at once."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable

from starlette.types import Message, Receive, Scope, Send

from anchorflow_service.http.turns import Turns

HEALTH = "/v2/health/ready"


def begun_by_pass(paths: Iterable[str], *, gone: Iterable[int] = ()) -> list[list[str]]:
    """What begins in each pass of the event loop, of requests that come at once.

    gone: which of them are cancelled before the second pass
    """
    begun: list[str] = []

    async def app(scope: Scope, _receive: Receive, _send: Send) -> None:
        begun.append(scope["path"])
        await asyncio.sleep(1e-3)

    async def receive() -> Message:
        return {"type": "http.request"}

    async def send(_: Message) -> None:
        return

    async def come() -> list[list[str]]:
        turns, passes = Turns(app), []
        crowd = [
            asyncio.ensure_future(turns({"type": "http", "path": path}, receive, send))
            for path in paths
        ]
        while not all(each.done() for each in crowd):
            before = len(begun)
            await asyncio.sleep(0)
            passes.append(begun[before:])
            for number in gone:
                crowd[number].cancel()
        return [some for some in passes if some]

    return asyncio.run(come())


def test_of_a_crowd_one_begins_a_pass_in_the_order_in_which_they_came() -> None:
    paths = [f"/{number}" for number in range(8)]
    assert begun_by_pass(paths) == [[path] for path in paths]


def test_health_begins_at_once() -> None:
    first, *_ = begun_by_pass(["/anchors"] * 8 + [HEALTH])
    assert first == ["/anchors", HEALTH]


def test_one_that_hangs_up_while_it_waits_keeps_nobody_from_theirs() -> None:
    assert begun_by_pass("abc", gone=[1]) == [["a"], ["c"]]
