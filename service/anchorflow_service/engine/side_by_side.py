"""Tasks of one request, done by the thread that asks and by others beside it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor, wait
from typing import TypeVar

Result = TypeVar("Result")


def side_by_side(pool: Executor, tasks: Sequence[Callable[[], Result]]) -> list[Result]:
    """What the tasks return; the first is done here, the others by the pool.

    It comes back once all have ended: one that is left behind would keep a core busy unseen.

    Raises:
        Exception: what the first of the tasks raises that does.
    """
    others = [pool.submit(task) for task in tasks[1:]]
    try:
        own = tasks[0]()
    finally:
        wait(others)
    return [own, *(other.result() for other in others)]
