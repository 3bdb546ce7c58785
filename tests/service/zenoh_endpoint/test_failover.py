"""Replicas that die, hang or are full: the client asks another within the same time."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from anchorflow_benchmarks.failover import (
    FailoverConfig,
    failover,
    kill_in_mid_answer,
    witness,
)
from anchorflow_benchmarks.programs import Program, router_command, running
from anchorflow_client import AnchorRequest, ConnectionFailed, TimedOut
from anchorflow_client.zenoh_client import ZenohAnchorClient

REPLICA = Path(__file__).parent / "programs" / "replica.py"
SECONDS = float(os.environ.get("ANCHORFLOW_FAILOVER_SECONDS", "4"))
"""Of the run with a kill and a return; 60 for the whole of what is promised."""


def replica(name: str, endpoint: str, answer_s: float) -> Program:
    return Program(name, [sys.executable, str(REPLICA), endpoint, name, str(answer_s)])


@pytest.fixture
def router(endpoint: str) -> Iterator[Program]:
    with running(Program("router", router_command(endpoint))) as router:
        yield router


@pytest.fixture
def two(router: Program, endpoint: str) -> Iterator[list[Program]]:
    """Replicas "a" and "b" behind the router, each of which takes 40 ms."""
    assert router.name == "router"
    with ExitStack() as stack:
        yield [stack.enter_context(running(replica(name, endpoint, 0.04))) for name in "ab"]


@pytest.fixture
def request_(fields: dict[str, Any]) -> AnchorRequest:
    return AnchorRequest.from_fields(fields)


def test_no_request_is_lost_while_a_replica_is_killed_and_comes_back(
    two: list[Program], endpoint: str, request_: AnchorRequest
) -> None:
    config = FailoverConfig(hz=20, seconds=SECONDS, mid_answer_s=0.01)
    with ZenohAnchorClient(endpoint, timeout_s=20) as client:
        outcome = failover(client, two, request_, config)

    assert outcome.outcomes.errors == {}
    assert len(outcome.outcomes.ms) == int(config.hz * config.seconds)
    assert outcome.seen.silent[outcome.killed] >= 1  # it was asked, and died over it
    assert outcome.after_return[outcome.killed] >= 1  # it answers again
    (other,) = {"a", "b"} - {outcome.killed}
    assert outcome.seen.answered[other] >= 1


def test_a_budget_holds_for_the_failover_too(
    router: Program, endpoint: str, fields: dict[str, Any], until: Any
) -> None:
    """The first replica dies over the request, the second has not the time for it."""
    assert router.name == "router"
    with ExitStack() as stack:
        slow = [stack.enter_context(running(replica(name, endpoint, 60.0))) for name in "ab"]
        client = stack.enter_context(ZenohAnchorClient(endpoint))
        assert client.ready()
        by_name = {process.name: process for process in slow}
        seen, executor = stack.enter_context(witness()), stack.enter_context(ThreadPoolExecutor(1))
        deaf = seen.on_asking
        killing = executor.submit(kill_in_mid_answer, by_name, seen, after_s=0.2)
        until(lambda: seen.on_asking is not deaf)
        with pytest.raises(TimedOut, match=r"within 4000 ms; asked (a, b|b, a)"):
            client.plan(**fields, budget_ms=4000)
        assert killing.result() in by_name


def test_a_replica_that_hangs_is_not_waited_for_alone(
    two: list[Program], endpoint: str, fields: dict[str, Any]
) -> None:
    """Stopped, it keeps its connection and its token, and answers nothing."""
    request = AnchorRequest.from_fields(fields | {"budget_ms": 6000})
    with ZenohAnchorClient(endpoint) as client, witness() as seen, ThreadPoolExecutor(4) as pool:
        client.plan_request(request)
        seen.asked.clear()
        two[0].signal(signal.SIGSTOP)
        try:
            # More at a time than one replica is given while the other seems idle.
            answers = list(pool.map(client.plan_request, [request] * 4))
        finally:
            two[0].signal(signal.SIGCONT)

    assert [answer.model.name for answer in answers] == ["sleeper"] * 4
    assert seen.asked["a"] >= 1


def test_with_nobody_left_it_says_so(
    two: list[Program], endpoint: str, fields: dict[str, Any]
) -> None:
    with ZenohAnchorClient(endpoint, timeout_s=20) as client:
        client.plan(**fields)
        for process in two:
            process.kill()
        with pytest.raises(ConnectionFailed):
            client.plan(**fields)
