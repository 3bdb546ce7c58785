"""A service that is lost for 2 s: no plan is used beyond its limit, and a new plan follows.

The service is another process, called over zenoh by a `Planner`; the loop runs on the wall clock.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
import pytest

from anchorflow_client import ConnectionFailed, PlannerConfig, TimedOut
from anchorflow_client.planner import Planner
from anchorflow_client.planner.plan import Plan, PlanState
from anchorflow_client.zenoh_client import ZenohAnchorClient

LOST_S = 2.0
TICK_S = 0.02
PATIENCE_S = 60.0
CONFIG = PlannerConfig(max_age_ms=1000.0, period_ms=50.0)


class Tick(NamedTuple):
    """A plan, and the wall clock before and after `update` returned it."""

    before: float
    after: float
    plan: Plan

    @property
    def number(self) -> int:
        """The number of the request that it answers, from 0; -1 without an answer."""
        request_id = self.plan.request_id
        return -1 if request_id is None else int(request_id.rpartition("-")[2])


class Loop:
    """A control loop that records its plans, and the ticks that sent a request."""

    def __init__(self, planner: Planner) -> None:
        self._planner = planner
        self.asked: list[Tick] = []
        self.ticks: list[Tick] = []

    def run(self, until: Callable[[list[Tick]], bool]) -> list[Tick]:
        """Tick until the condition holds for the ticks of this call, and return them."""
        first, deadline = len(self.ticks), time.monotonic() + PATIENCE_S
        while not until(self.ticks[first:]):
            assert time.monotonic() < deadline
            before = time.monotonic()
            plan = self._planner.update(
                cost_map=np.zeros((64, 64)),
                resolution=0.16,
                x_curr=[-3.0, 0.0, 0.0, 0.0, 0.0, 0.0],
                x_goal=[3.0, 0.0, 0.0, 0.0],
                num_samples=2,
            )
            self.ticks.append(Tick(before, time.monotonic(), plan))
            if self._planner.counts["asked"] > len(self.asked):
                self.asked.append(self.ticks[-1])
            time.sleep(TICK_S)
        return self.ticks[first:]

    def run_until_answered(self) -> list[Tick]:
        """Run until a request is answered that is sent from now on."""
        number = len(self.asked)
        return self.run(lambda ticks: bool(ticks) and ticks[-1].number >= number)

    def check_ages(self) -> None:
        """Check every plan's age by the loop's own clock and records."""
        newest = -1
        for tick in self.ticks:
            plan = tick.plan
            assert plan.usable == (plan.state in (PlanState.FRESH, PlanState.HELD))
            if tick.number < 0:
                assert plan.state is PlanState.WAITING
                continue
            seen = self.asked[tick.number]
            youngest_ms = 1e3 * (tick.before - seen.after)
            assert youngest_ms <= plan.age_ms <= 1e3 * (tick.after - seen.before)
            assert plan.usable == (plan.age_ms <= CONFIG.max_age_ms)
            if plan.batch is not None:
                assert youngest_ms <= CONFIG.max_age_ms
                assert plan.batch.request_id == plan.request_id
            assert tick.number >= newest  # no late answer replaces a newer one
            newest = tick.number


@pytest.mark.parametrize(("where", "how"), [("behind a router", "killed"), ("alone", "stopped")])
def test_a_service_that_is_lost_for_2_s(
    start_router: Any, start_replica: Any, endpoint: str, where: str, how: str
) -> None:
    listens = ["listen"] if where == "alone" else []
    if not listens:
        start_router()
    service = start_replica("a", 0.01, *listens)
    with (
        ZenohAnchorClient(endpoint, timeout_s=1.0) as client,
        Planner(client, CONFIG) as planner,
        ThreadPoolExecutor(1) as executor,
    ):
        loop = Loop(planner)
        loop.run_until_answered()
        end = time.monotonic() + 0.5
        loop.run(lambda _: time.monotonic() >= end)
        if how == "stopped":
            service.signal(signal.SIGSTOP)
        else:
            service.kill()
        asked_before, end = len(loop.asked), time.monotonic() + LOST_S
        expired = [PlanState.EXPIRED] * 5
        lost = loop.run(
            lambda ticks: (
                time.monotonic() >= end
                and ticks[-1].plan.last_error is not None
                and [tick.plan.state for tick in ticks[-5:]] == expired
            )
        )
        if how == "stopped":
            service.signal(signal.SIGCONT)
        else:
            restarted = executor.submit(service.start)
            loop.run(lambda _: restarted.done())
        back = loop.run_until_answered()

    loop.check_ages()
    usable = [tick.plan.usable for tick in lost]
    assert usable[0]  # it continues with its last plan
    assert not usable[-1]  # and brakes
    assert usable == sorted(usable, reverse=True)  # and no old plan is used again
    assert isinstance(lost[-1].plan.last_error, TimedOut | ConnectionFailed)
    assert all(tick.number < asked_before for tick in lost)  # no request was answered
    assert back[-1].plan.state is PlanState.FRESH
