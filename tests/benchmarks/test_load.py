"""Closed-loop clients, against callables that stand for servers."""

from __future__ import annotations

import threading
import time
from contextlib import ExitStack
from typing import Any

import pytest

from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.load import Connect, LoadConfig, load_table, over_http, run_level
from anchorflow_client import JsonCodec
from anchorflow_client.errors import Overloaded

REQUESTS: Any = ["first", "second"]


class Server:
    """Answers after 2 ms, one client at a time or all; refuses every `refuse`-th request."""

    def __init__(self, *, refuse: int = 0) -> None:
        self.asked: list[str] = []
        self.busy = self.most_busy = self.connections = 0
        self.refuse = refuse
        self.lock = threading.Lock()

    def connect(self, stack: ExitStack) -> Any:
        self.connections += 1
        stack.callback(self.leave)
        return self.ask

    def leave(self) -> None:
        self.connections -= 1

    def ask(self, request: str) -> None:
        with self.lock:
            self.asked.append(request)
            self.busy += 1
            self.most_busy = max(self.most_busy, self.busy)
            refused = self.refuse and len(self.asked) % self.refuse == 0
        time.sleep(0.002)
        with self.lock:
            self.busy -= 1
        if refused:
            raise Overloaded("too many", retry_after_s=1)


def test_a_level_ends_after_its_requests() -> None:
    server = Server()
    row = run_level(server.connect, 3, REQUESTS, LoadConfig(seconds=20, requests=30))

    assert row["requests"] == 30
    assert len(server.asked) == 31  # one goes ahead, not counted
    assert set(server.asked) == set(REQUESTS)
    assert 1 < server.most_busy <= 3
    assert server.connections == 0
    assert float(row["p99 ms"] or 0) >= float(row["p50 ms"] or 0) >= 2.0


def test_a_level_ends_after_its_time() -> None:
    start = time.perf_counter()
    row = run_level(Server().connect, 2, REQUESTS, LoadConfig(seconds=0.1, requests=10**6))

    assert time.perf_counter() - start < 5
    assert float(row["per second"] or 0) > 0


def test_errors_are_counted_by_code() -> None:
    server = Server(refuse=5)
    row = run_level(server.connect, 1, REQUESTS, LoadConfig(seconds=20, requests=20))

    assert (row["requests"], row["errors"], row["error codes"]) == (16, 4, "overloaded 4")


def test_a_row_for_each_way_and_number_of_clients() -> None:
    ways: dict[str, Connect] = {"a": Server().connect, "b": Server().connect}
    table = load_table(ways, REQUESTS, LoadConfig(clients=(1, 2), seconds=20, requests=4))

    assert [(row["way"], row["clients"]) for row in table.rows] == [
        ("a", 1),
        ("b", 1),
        ("a", 2),
        ("b", 2),
    ]


@pytest.mark.parametrize("url", ["http://192.0.2.1:8000", "http://robot.example", "nonsense"])
def test_another_machine_is_not_loaded(url: str) -> None:
    with pytest.raises(BenchmarkError, match="of this machine"):
        over_http(url, JsonCodec())


@pytest.mark.parametrize("url", ["http://127.0.0.1:8000", "http://localhost:1", "http://[::1]:80"])
def test_this_machine_is(url: str) -> None:
    with ExitStack() as stack:
        assert callable(over_http(url, JsonCodec())(stack))
