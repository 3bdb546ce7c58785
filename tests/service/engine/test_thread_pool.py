"""Tasks of one request on several threads: in order, all joined, and no exception lost."""

from __future__ import annotations

import threading
import time
import weakref
from collections.abc import Callable

import pytest

from anchorflow_service.engine.thread_pool import ThreadPool


@pytest.fixture
def pool() -> ThreadPool:
    return ThreadPool(2, name="helping")


def test_results_come_in_order_and_the_first_is_made_here(pool: ThreadPool) -> None:
    both = threading.Barrier(2, timeout=10.0)  # passed only by two at a time

    def meet(name: str) -> tuple[str, int]:
        both.wait()
        return name, threading.get_ident()

    (first, here), (second, there) = pool.run([lambda: meet("a"), lambda: meet("b")])
    assert (first, second) == ("a", "b")
    assert here == threading.get_ident() != there


@pytest.mark.parametrize("failing", [0, 1])
def test_a_fault_is_raised_once_all_have_ended(pool: ThreadPool, failing: int) -> None:
    ended = threading.Event()

    def fail() -> None:
        raise ValueError("this one")

    def last() -> None:
        time.sleep(0.1)
        ended.set()

    tasks: list[Callable[[], None]] = [last, fail] if failing else [fail, last]
    with pytest.raises(ValueError, match="this one"):
        pool.run(tasks)
    assert ended.is_set()


def test_helpers_begin_when_they_are_needed_and_end_with_their_owner() -> None:
    def alive() -> int:
        return sum(thread.name.startswith("of-this-test") for thread in threading.enumerate())

    pool = ThreadPool(3, name="of-this-test")
    assert pool.run([lambda: "alone"]) == ["alone"]
    assert alive() == 0
    assert pool.run([lambda: 1, lambda: 2, lambda: 3, lambda: 4, lambda: 5])[4] == 5
    assert alive() == 3
    del pool
    deadline = time.monotonic() + 10.0
    while alive() and time.monotonic() < deadline:
        time.sleep(0.01)
    assert alive() == 0


def test_nothing_of_a_request_is_kept(pool: ThreadPool) -> None:
    class Array:
        pass

    kept = Array()
    gone = weakref.ref(kept)
    pool.run([lambda: None, lambda held=kept: held])
    del kept
    deadline = time.monotonic() + 10.0
    while gone() is not None and time.monotonic() < deadline:
        time.sleep(0.01)
    assert gone() is None
