"""A service that is lost for 2 s: no plan is used beyond its limit, and a new plan follows.

The service is another process, called over zenoh by a `Planner`; the loop runs on the wall clock.
"""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from anchorflow_benchmarks.programs import Program, router_command, running
from anchorflow_client import ConnectionFailed, PlannerConfig, TimedOut
from anchorflow_client.planner import Planner
from anchorflow_client.planner.plan import Plan, PlanState
from anchorflow_client.zenoh_client import ZenohAnchorClient

REPLICA = Path(__file__).parent / "programs" / "replica.py"
LOST_S = 2.0
TICK_S = 0.02
PATIENCE_S = 60.0
CONFIG = PlannerConfig(max_age_ms=1000.0, period_ms=50.0)


class Moment(NamedTuple):
    """The wall clock before and after a call."""

    before: float
    after: float


class Handed(NamedTuple):
    """A plan, and when the loop received it."""

    at: Moment
    plan: Plan

    @property
    def number(self) -> int:
        """The number of the request that it answers, from 0; -1 without an answer."""
        request_id = self.plan.request_id
        return -1 if request_id is None else int(request_id.rpartition("-")[2])


class Loop:
    """A control loop that records its plans, and when its requests were sent."""

    def __init__(self, planner: Planner) -> None:
        self._planner = planner
        self.asked: list[Moment] = []
        self.handed: list[Handed] = []

    def run(self, until: Callable[[], bool]) -> list[Handed]:
        """Tick until the condition holds, and return the plans of that time."""
        first, deadline = len(self.handed), time.monotonic() + PATIENCE_S
        while not until():
            assert time.monotonic() < deadline
            self._tick()
            time.sleep(TICK_S)
        return self.handed[first:]

    def run_for(self, seconds: float) -> list[Handed]:
        end = time.monotonic() + seconds
        return self.run(lambda: time.monotonic() >= end)

    def run_lost(self) -> list[Handed]:
        """Run while the service is lost, and until the plan has expired for sure."""
        end = time.monotonic() + LOST_S
        first = len(self.handed)
        expired = [PlanState.EXPIRED] * 5
        return self.run(
            lambda: (
                time.monotonic() >= end
                and self.handed[-1].plan.last_error is not None
                and [handed.plan.state for handed in self.handed[first:][-5:]] == expired
            )
        )

    def run_until_answered(self) -> list[Handed]:
        """Run until a request is answered that is sent from now on."""
        number = len(self.asked)
        return self.run(lambda: bool(self.handed) and self.handed[-1].number >= number)

    def _tick(self) -> None:
        before = time.monotonic()
        plan = self._planner.update(
            cost_map=np.zeros((64, 64)),
            resolution=0.16,
            x_curr=[-3.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            x_goal=[3.0, 0.0, 0.0, 0.0],
            num_samples=2,
        )
        now = Moment(before, time.monotonic())
        if self._planner.counts["asked"] > len(self.asked):
            self.asked.append(now)
        self.handed.append(Handed(now, plan))


@pytest.fixture(params=["behind a router", "alone"])
def service(request: pytest.FixtureRequest, endpoint: str) -> Iterator[Program]:
    """Start a replica in another process, with 10 ms for an answer."""
    listens = ["listen"] if request.param == "alone" else []
    command = [sys.executable, str(REPLICA), endpoint, "a", "0.01", *listens]
    with ExitStack() as stack:
        if not listens:
            stack.enter_context(running(Program("router", router_command(endpoint))))
        yield stack.enter_context(running(Program("a", command)))


@pytest.fixture
def loop(service: Program, endpoint: str) -> Iterator[Loop]:
    assert service.name == "a"
    timeout_s = 1e-3 * CONFIG.max_age_ms
    with ZenohAnchorClient(endpoint, timeout_s=timeout_s) as client, Planner(client, CONFIG) as it:
        yield Loop(it)


def check_ages(loop: Loop) -> None:
    """Check every plan's age by the loop's own clock and records."""
    newest = -1
    for handed in loop.handed:
        (before, after), plan = handed
        assert plan.usable == (plan.state in (PlanState.FRESH, PlanState.HELD))
        if handed.number < 0:
            assert plan.state is PlanState.WAITING
            continue
        seen = loop.asked[handed.number]
        youngest_ms, oldest_ms = 1e3 * (before - seen.after), 1e3 * (after - seen.before)
        assert youngest_ms <= plan.age_ms <= oldest_ms
        assert plan.usable == (plan.age_ms <= CONFIG.max_age_ms)
        if plan.batch is not None:
            assert youngest_ms <= CONFIG.max_age_ms
            assert plan.batch.request_id == plan.request_id
        assert handed.number >= newest  # no late answer replaces a newer one
        newest = handed.number


def check_loss(lost: list[Handed], asked_before: int) -> None:
    """Check the plans that the planner returned while the service was lost."""
    usable = [handed.plan.usable for handed in lost]
    assert usable[0]  # it continues with its last plan
    assert not usable[-1]  # and brakes
    assert usable == sorted(usable, reverse=True)  # and no old plan is used again
    assert isinstance(lost[-1].plan.last_error, TimedOut | ConnectionFailed)
    assert all(handed.number < asked_before for handed in lost)  # no request was answered


@pytest.mark.parametrize("how", ["stopped", "killed and restarted"])
def test_a_service_that_is_lost_for_2_s(service: Program, loop: Loop, how: str) -> None:
    loop.run_until_answered()
    loop.run_for(0.5)
    if how == "stopped":
        service.signal(signal.SIGSTOP)
    else:
        service.kill()
    asked_before = len(loop.asked)
    lost = loop.run_lost()
    with ThreadPoolExecutor(1) as executor:
        if how == "stopped":
            service.signal(signal.SIGCONT)
        else:
            loop.run(executor.submit(service.start).done)
        back = loop.run_until_answered()

    check_ages(loop)
    check_loss(lost, asked_before)
    assert back[-1].plan.state is PlanState.FRESH
