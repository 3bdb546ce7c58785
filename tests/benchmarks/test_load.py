"""Closed-loop clients of callables that stand for servers."""

from __future__ import annotations

import threading
from contextlib import ExitStack
from types import SimpleNamespace
from typing import Any

import pytest

from anchorflow_benchmarks import BenchmarkError
from anchorflow_benchmarks.load import (
    Connect,
    LoadConfig,
    asking,
    load_table,
    over_http,
    run_level,
)
from anchorflow_client import JsonCodec
from anchorflow_client.contract import ModelId
from anchorflow_client.errors import Overloaded

REQUESTS: Any = ["first", "second"]
MODEL = ModelId("stub", "1", "0")
LONG_S = 600.0


class Server:
    """Answers at once; refuses every `refuse`-th request with a Retry-After."""

    def __init__(self, *, refuse: int = 0, retry_after_s: float = 0.0) -> None:
        self.asked: list[str] = []
        self.connections = 0
        self._refuse, self._retry_after_s = refuse, retry_after_s
        self._lock = threading.Lock()

    def connect(self, stack: ExitStack) -> Any:
        self.connections += 1
        stack.callback(self.leave)
        return self.ask

    def leave(self) -> None:
        self.connections -= 1

    def ask(self, request: str) -> Any:
        with self._lock:
            self.asked.append(request)
            count = len(self.asked)
        if self._refuse and count % self._refuse == 0:
            raise Overloaded("too many", retry_after_s=self._retry_after_s)
        return SimpleNamespace(model=MODEL)


def test_a_level_tells_what_came_of_its_requests() -> None:
    # The first goes ahead and is not counted.
    row = run_level(Server(refuse=5).connect, 1, REQUESTS, LoadConfig(seconds=60, requests=19))

    assert (row["requests"], row["errors"], row["error codes"]) == (15, 4, "overloaded 4")
    assert float(row["p99 ms"] or 0) >= float(row["p50 ms"] or 0) > 0
    assert float(row["per second"] or 0) > 0


def test_a_row_for_each_way_and_number_of_clients() -> None:
    ways: dict[str, Connect] = {"a": Server().connect, "b": Server().connect}
    table = load_table(ways, REQUESTS, LoadConfig(clients=(1, 2), seconds=60, requests=4))

    assert [(row["way"], row["clients"], row["requests"]) for row in table.rows] == [
        ("a", 1, 4),
        ("b", 1, 4),
        ("a", 2, 4),
        ("b", 2, 4),
    ]


def test_they_ask_so_many_questions_in_all_and_leave() -> None:
    server = Server()
    with asking(server.connect, REQUESTS, callers=3, seconds=LONG_S, questions=30) as outcomes:
        assert server.connections == 3

    assert server.connections == 0
    assert len(server.asked) == len(outcomes.ms) == 30
    assert set(server.asked) == set(REQUESTS)
    assert outcomes.models == {MODEL: 30}
    assert outcomes.elapsed_s > 0


def test_they_ask_at_the_same_time() -> None:
    """Each of three waits until all three have asked."""
    together = threading.Barrier(3)

    def ask(_: Any) -> Any:
        together.wait(LONG_S)
        return SimpleNamespace(model=MODEL)

    with asking(lambda _: ask, REQUESTS, callers=3, seconds=LONG_S, questions=6) as outcomes:
        pass

    assert len(outcomes.ms) == 6


def test_they_ask_for_so_long() -> None:
    with asking(Server().connect, REQUESTS, callers=2, seconds=0.05) as outcomes:
        pass

    assert outcomes.ms
    assert outcomes.elapsed_s >= 0.05


def test_who_is_told_to_come_back_later_does() -> None:
    server = Server(refuse=1, retry_after_s=LONG_S)
    with asking(server.connect, REQUESTS, callers=1, seconds=0.05) as outcomes:
        pass

    assert outcomes.errors == {"overloaded": 1}


def test_where_the_block_fails_they_ask_no_more() -> None:
    server = Server(refuse=1, retry_after_s=LONG_S)
    with (
        pytest.raises(ZeroDivisionError),
        asking(server.connect, REQUESTS, callers=2, seconds=LONG_S),
    ):
        _ = 1 / 0

    assert server.connections == 0


@pytest.mark.parametrize("url", ["http://192.0.2.1:8000", "http://robot.example", "nonsense"])
def test_another_machine_is_not_loaded(url: str) -> None:
    with pytest.raises(BenchmarkError, match="of this machine"):
        over_http(url, JsonCodec())


@pytest.mark.parametrize("url", ["http://127.0.0.1:8000", "http://localhost:1", "http://[::1]:80"])
def test_this_machine_is_loaded(url: str) -> None:
    with ExitStack() as stack:
        assert callable(over_http(url, JsonCodec())(stack))
