"""A slow call in the background: nobody waits longer than he allows, and nothing is lost."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from anchorflow_client import Cancellation, Cancelled, ConnectionFailed, TimedOut
from anchorflow_client.cancellation import Deadline
from anchorflow_client.zenoh_client.network import Background

PATIENCE_S = 20


def test_who_comes_later_gets_what_nobody_waited_for() -> None:
    opened, calls = threading.Event(), []

    def slow() -> int:
        calls.append(1)
        assert opened.wait(PATIENCE_S)
        return len(calls)

    background = Background(slow, name="slow")
    for _ in range(2):
        with pytest.raises(TimedOut, match="slow: not done within 10 ms"):
            background.result(Deadline(0.01))
    opened.set()

    assert background.result(Deadline(PATIENCE_S)) == 1
    assert background.result(Deadline(PATIENCE_S)) == 2


def test_an_error_is_raised_where_the_result_is_wanted() -> None:
    def fail() -> None:
        raise ConnectionFailed("nobody is there")

    background = Background(fail, name="failing")
    for _ in range(2):
        with pytest.raises(ConnectionFailed, match="nobody is there"):
            background.result(Deadline(PATIENCE_S))


def test_those_who_wait_together_wait_for_one_call() -> None:
    opened, calls = threading.Event(), []

    def slow() -> int:
        calls.append(1)
        assert opened.wait(PATIENCE_S)
        return len(calls)

    background = Background(slow, name="slow")
    with ThreadPoolExecutor(4) as executor:
        waiting = [executor.submit(background.result, Deadline(PATIENCE_S)) for _ in range(4)]
        with pytest.raises(TimedOut):
            background.result(Deadline(0.05))
        assert calls == [1]
        opened.set()
        assert 1 in {each.result(PATIENCE_S) for each in waiting}


def test_who_gives_up_leaves_the_call_to_others() -> None:
    opened, cancellation = threading.Event(), Cancellation()
    background = Background(lambda: opened.wait(PATIENCE_S), name="slow")
    with ThreadPoolExecutor(2) as executor:
        waiting = executor.submit(background.result, Deadline(PATIENCE_S))
        given_up = executor.submit(background.result, Deadline(PATIENCE_S, cancellation))
        cancellation.cancel()
        with pytest.raises(Cancelled):
            given_up.result()
        opened.set()
        assert waiting.result() is True
