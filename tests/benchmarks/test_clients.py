"""Callers that ask again and again, of callables that stand for servers."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from contextlib import ExitStack
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from anchorflow_benchmarks.clients import Outcomes, asking, over_http, retrying
from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.planners import request_of
from anchorflow_client import JsonCodec
from anchorflow_client.contract import ModelId, OdeSpec
from anchorflow_client.errors import ConnectionFailed, Overloaded
from anchorflow_trajectory.scene import Scene

REQUESTS: Any = ["first", "second"]
MODEL = ModelId("stub", "1", "0")
LONG_S = 600.0


class Server:
    """Answers at once; refuses every `refuse`-th question, to be asked again after so long."""

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


def test_errors_are_counted_by_code() -> None:
    server = Server(refuse=5)
    with asking(server.connect, REQUESTS, callers=1, seconds=LONG_S, questions=20) as outcomes:
        pass

    assert (len(outcomes.ms), outcomes.failed, outcomes.errors) == (16, 4, {"overloaded": 4})


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


def test_outcomes_of_two_rounds_add_up() -> None:
    one = Outcomes([1.0], elapsed_s=2.0)
    other = Outcomes([3.0, 125.0], elapsed_s=1.0)
    other.errors["overloaded"] += 1
    both = one + other

    assert (both.ms, both.errors, both.per_second) == ([1.0, 3.0, 125.0], {"overloaded": 1}, 1.0)
    assert (both.p50_ms, both.longest_ms, both.late(100.0)) == (3.0, 125.0, 1)
    assert (Outcomes().p50_ms, Outcomes().p99_ms, Outcomes().longest_ms) == (None, None, None)


def test_every_attempt_of_who_asks_again_is_noted(scene: Callable[..., Scene]) -> None:
    sampler = OdeSpec("euler", (0.0, 1.0))
    request = request_of(scene(np.zeros((64, 64), bool)), num=1, seed=0, sampler=sampler)
    attempts = Outcomes()
    with socket.socket() as deaf, ExitStack() as stack:
        deaf.bind(("127.0.0.1", 0))  # and does not listen
        url = f"http://127.0.0.1:{deaf.getsockname()[1]}"
        ask = retrying(url, attempts, timeout_s=1.0, patience_s=0.5)(stack)
        with pytest.raises(ConnectionFailed):
            ask(request)

    assert attempts.errors["ConnectionFailed"] == attempts.failed > 1


@pytest.mark.parametrize("url", ["http://192.0.2.1:8000", "http://robot.example", "nonsense"])
def test_another_machine_is_not_loaded(url: str) -> None:
    with pytest.raises(BenchmarkError, match="of this machine"):
        over_http(url, JsonCodec())


@pytest.mark.parametrize("url", ["http://127.0.0.1:8000", "http://localhost:1", "http://[::1]:80"])
def test_this_machine_is(url: str) -> None:
    with ExitStack() as stack:
        assert callable(over_http(url, JsonCodec())(stack))
