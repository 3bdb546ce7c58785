"""A service that is lost for 2 s: the last plan is used up to its limit, and a new plan follows.

The service is another process, called over zenoh by a `Planner`; the loop runs on the wall clock.
What a planner does with late and lost answers is in `tests/client/test_planner_failures.py`.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
from staged_planner import VIEW

from anchorflow_client import ConnectionFailed, PlannerConfig, TimedOut
from anchorflow_client.planner import Planner
from anchorflow_client.planner.plan import Plan, PlanState
from anchorflow_client.zenoh_client import ZenohAnchorClient

LOST_S = 2.0
TICK_S = 0.02
PATIENCE_S = 60.0


def run(planner: Planner, until: Callable[[list[Plan]], bool]) -> list[Plan]:
    """Update at every tick until the condition holds for the plans, and return them."""
    plans, deadline = [planner.update(**VIEW, num_samples=2)], time.monotonic() + PATIENCE_S
    while not until(plans):
        assert time.monotonic() < deadline
        time.sleep(TICK_S)
        plans.append(planner.update(**VIEW, num_samples=2))
    return plans


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
        Planner(client, PlannerConfig(max_age_ms=1000.0, period_ms=50.0)) as planner,
        ThreadPoolExecutor(1) as executor,
    ):
        *_, good = run(planner, lambda plans: plans[-1].state is PlanState.FRESH)
        assert good.batch is not None
        if how == "stopped":
            service.signal(signal.SIGSTOP)
        else:
            service.kill()
        end = time.monotonic() + LOST_S
        lost = run(
            planner,
            lambda plans: (
                time.monotonic() >= end
                and plans[-1].last_error is not None
                and {plan.state for plan in plans[-5:]} == {PlanState.EXPIRED}
            ),
        )
        if how == "stopped":
            service.signal(signal.SIGCONT)
        else:
            restarted = executor.submit(service.start)
            run(planner, lambda _: restarted.done())
        *_, back = run(planner, lambda plans: plans[-1].state is PlanState.FRESH)

    usable = [plan.usable for plan in lost]
    assert usable[0]  # it continues with its last plan
    assert usable == sorted(usable, reverse=True)  # and brakes, and uses no old plan again
    assert all(plan.usable == (plan.age_ms <= 1000.0) for plan in lost)
    assert isinstance(lost[-1].last_error, TimedOut | ConnectionFailed)
    assert back.request_id not in {plan.request_id for plan in lost}
