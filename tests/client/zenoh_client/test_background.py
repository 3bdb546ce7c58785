"""A slow call in the background: nobody waits longer than he allows, and nothing is lost."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from anchorflow_client import ConnectionFailed, TimedOut
from anchorflow_client.zenoh_client.background import Background

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
            background.result(0.01)
    opened.set()

    assert background.result(PATIENCE_S) == 1
    assert background.result(PATIENCE_S) == 2


def test_an_error_is_raised_where_the_result_is_wanted() -> None:
    def fail() -> None:
        raise ConnectionFailed("nobody is there")

    background = Background(fail, name="failing")
    for _ in range(2):
        with pytest.raises(ConnectionFailed, match="nobody is there"):
            background.result(PATIENCE_S)


def test_those_who_wait_together_wait_for_one_call() -> None:
    opened, calls = threading.Event(), []

    def slow() -> int:
        calls.append(1)
        assert opened.wait(PATIENCE_S)
        return len(calls)

    background = Background(slow, name="slow")
    with ThreadPoolExecutor(4) as executor:
        waiting = [executor.submit(background.result, PATIENCE_S) for _ in range(4)]
        with pytest.raises(TimedOut):
            background.result(0.05)
        assert calls == [1]
        opened.set()
        assert 1 in {each.result(PATIENCE_S) for each in waiting}
