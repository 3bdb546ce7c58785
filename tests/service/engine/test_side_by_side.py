"""Tasks of one request on several threads: in order, ended before it goes on, and no fault lost."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

from anchorflow_service.engine.side_by_side import side_by_side


@pytest.fixture
def pool() -> Iterator[ThreadPoolExecutor]:
    with ThreadPoolExecutor(2) as executor:
        yield executor


def test_results_come_in_order_and_the_first_is_made_here(pool: ThreadPoolExecutor) -> None:
    both = threading.Barrier(2, timeout=10.0)  # passed only by two at a time

    def meet(name: str) -> tuple[str, int]:
        both.wait()
        return name, threading.get_ident()

    (first, here), (second, there) = side_by_side(pool, [lambda: meet("a"), lambda: meet("b")])
    assert (first, second) == ("a", "b")
    assert here == threading.get_ident() != there


@pytest.mark.parametrize("failing", [0, 1])
def test_a_fault_is_raised_once_all_have_ended(pool: ThreadPoolExecutor, failing: int) -> None:
    ended = threading.Event()

    def fail() -> None:
        raise ValueError("this one")

    def last() -> None:
        time.sleep(0.1)
        ended.set()

    tasks: list[Callable[[], None]] = [last, fail] if failing else [fail, last]
    with pytest.raises(ValueError, match="this one"):
        side_by_side(pool, tasks)
    assert ended.is_set()
