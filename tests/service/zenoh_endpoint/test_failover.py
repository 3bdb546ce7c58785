"""Replicas that die, hang or are overloaded: the client queries another in the same time."""

from __future__ import annotations

import logging
import os
import queue
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import pytest

from anchorflow_benchmarks.programs import Program
from anchorflow_client import AnchorBatch, AnchorRequest, ConnectionFailed, TimedOut
from anchorflow_client.zenoh_client import ZenohAnchorClient

SECONDS = float(os.environ.get("ANCHORFLOW_FAILOVER_SECONDS", "4"))
"""Duration of the run with a kill and a return."""
HZ, KILL_AT, BACK_AT = 20, 0.3, 0.5  # shares of the run
Start = Callable[..., Program]
CLIENT_LOG = "anchorflow_client.zenoh_client.failover"


class Witness(logging.Handler):
    """Counts requests, answers and failures of each replica in the client's log."""

    def __init__(self) -> None:
        super().__init__(logging.DEBUG)
        self.asked: Counter[str] = Counter()
        self.answered: Counter[str] = Counter()
        self.silent: Counter[str] = Counter()
        self.on_asking: Callable[[str], None] = lambda _: None

    def emit(self, record: logging.LogRecord) -> None:
        words, args = str(record.msg), record.args
        if not isinstance(args, tuple) or len(args) < 2:
            return
        name = str(args[1])
        if "asking" in words:
            self.asked[name] += 1
            self.on_asking(name)
        elif "answered in" in words:
            self.answered[name] += 1
        elif "nothing came" in words:
            self.silent[name] += 1


@contextmanager
def witness() -> Iterator[Witness]:
    """Read the client's log while the block runs."""
    log, seen = logging.getLogger(CLIENT_LOG), Witness()
    level = log.level
    log.addHandler(seen)
    log.setLevel(logging.DEBUG)
    try:
        yield seen
    finally:
        log.removeHandler(seen)
        log.setLevel(level)


def kill_in_mid_answer(by_name: Mapping[str, Program], seen: Witness, *, after_s: float) -> str:
    """Wait for a request to a replica, and kill the replica `after_s` later."""
    asked: queue.SimpleQueue[str] = queue.SimpleQueue()
    seen.on_asking = asked.put
    victim = asked.get()
    seen.on_asking = lambda _: None
    time.sleep(after_s)
    by_name[victim].kill()
    return victim


@pytest.fixture
def two(start_router: Start, start_replica: Start) -> list[Program]:
    """Replicas "a" and "b" behind a router, with 40 ms for an answer."""
    start_router()
    return [start_replica(name, 0.04) for name in "ab"]


@pytest.fixture
def request_(fields: dict[str, Any]) -> AnchorRequest:
    return AnchorRequest.from_fields(fields)


def test_no_request_is_lost_while_a_replica_is_killed_and_comes_back(
    two: list[Program], endpoint: str, request_: AnchorRequest, until: Any
) -> None:
    by_name = {replica.name: replica for replica in two}
    with (
        ZenohAnchorClient(endpoint, timeout_s=20) as client,
        witness() as seen,
        ThreadPoolExecutor(64) as pool,
        ThreadPoolExecutor(1) as clock,
    ):
        client.plan_request(request_)  # connect

        def ask_by_the_clock() -> list[Future[AnchorBatch]]:
            """Send a request every tick, whether the one before is answered or not."""
            start, answers = time.monotonic(), []
            for tick in range(int(HZ * SECONDS)):
                time.sleep(max(0.0, start + tick / HZ - time.monotonic()))
                answers.append(pool.submit(client.plan_request, request_))
            return answers

        asking = clock.submit(ask_by_the_clock)
        time.sleep(KILL_AT * SECONDS)
        killed = kill_in_mid_answer(by_name, seen, after_s=0.01)
        time.sleep((BACK_AT - KILL_AT) * SECONDS)
        by_name[killed].start()
        before = Counter(seen.answered)
        for answer in asking.result():
            answer.result()  # no request is lost
        # It answers again, if need be after the run: on a busy machine it starts slowly.
        until(lambda: client.plan_request(request_) and (seen.answered - before)[killed])

    assert seen.silent[killed] >= 1  # it was queried, and died
    (other,) = {"a", "b"} - {killed}
    assert seen.answered[other] >= 1


def test_a_budget_holds_for_the_failover_too(
    start_router: Start,
    start_replica: Start,
    endpoint: str,
    fields: dict[str, Any],
    until: Any,
) -> None:
    """The first replica dies during the request, and the second has too little time."""
    start_router()
    by_name = {name: start_replica(name, 60.0) for name in "ab"}
    with (
        ZenohAnchorClient(endpoint) as client,
        witness() as seen,
        ThreadPoolExecutor(1) as executor,
    ):
        assert client.ready()
        deaf = seen.on_asking
        killing = executor.submit(kill_in_mid_answer, by_name, seen, after_s=0.2)
        until(lambda: seen.on_asking is not deaf)
        with pytest.raises(TimedOut, match=r"within 4000 ms; asked (a, b|b, a)"):
            client.plan(**fields, budget_ms=4000)
        assert killing.result() in by_name


def test_a_replica_that_hangs_is_not_waited_for_alone(
    two: list[Program], endpoint: str, fields: dict[str, Any]
) -> None:
    """A stopped process keeps its connection and its token, and does not answer."""
    request = AnchorRequest.from_fields(fields | {"budget_ms": 6000})
    with ZenohAnchorClient(endpoint) as client, witness() as seen, ThreadPoolExecutor(4) as pool:
        client.plan_request(request)
        seen.asked.clear()
        two[0].signal(signal.SIGSTOP)
        try:
            # More than one replica gets while the other seems idle.
            answers = list(pool.map(client.plan_request, [request] * 4))
        finally:
            two[0].signal(signal.SIGCONT)

    assert [answer.model.name for answer in answers] == ["lines"] * 4
    assert seen.asked["a"] >= 1


def test_without_any_replica_left_the_connection_fails(
    two: list[Program], endpoint: str, fields: dict[str, Any]
) -> None:
    with ZenohAnchorClient(endpoint, timeout_s=20) as client:
        client.plan(**fields)
        for process in two:
            process.kill()
        with pytest.raises(ConnectionFailed):
            client.plan(**fields)
