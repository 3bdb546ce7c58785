"""The planner with real threads: the loop goes on while a client hangs."""

from __future__ import annotations

import threading

import numpy as np

from anchorflow_client import AnchorBatch, AnchorRequest, ConnectionFailed, ModelId
from anchorflow_client.planner import Planner, PlannerConfig
from anchorflow_client.planner.plan import Plan, PlanState

PATIENCE_S = 30.0  # of the test, for events that come at once


class GatedClient:
    """Answers nothing before its gate is open; a closed door refuses at once."""

    def __init__(self) -> None:
        self.gate = threading.Event()
        self.entered = threading.Event()
        self.is_lost = False
        self.thread: threading.Thread | None = None

    def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        self.thread = threading.current_thread()
        self.entered.set()
        assert self.gate.wait(PATIENCE_S)
        if self.is_lost:
            raise ConnectionFailed("nobody listens")
        paths = np.zeros((1, 4, 2), np.float32)
        return AnchorBatch(
            arrays={
                "trajectories": paths,
                "velocities": paths,
                "accelerations": paths,
                "scores": np.zeros(1, np.float32),
                "clearance": np.ones(1, np.float32),
                "safe": np.ones(1, bool),
            },
            dt=1.0,
            seed=0,
            model=ModelId("still", "1", "ab"),
            timing_ms={},
            request_id=request.request_id,
        )


def update(planner: Planner) -> Plan:
    return planner.update(
        cost_map=np.zeros((16, 16)), resolution=0.5, x_curr=np.zeros(6), x_goal=np.zeros(4)
    )


def test_the_loop_runs_on_while_the_client_hangs() -> None:
    client = GatedClient()
    with Planner(client, PlannerConfig(max_age_ms=1e6)) as planner:
        update(planner)
        assert client.entered.wait(PATIENCE_S)
        # Were an update to wait for the client, this line would never be reached: the gate is shut.
        assert [update(planner).state for _ in range(100)] == [PlanState.WAITING] * 100
        client.gate.set()
        plan = planner.wait(PATIENCE_S)

    assert plan.state is PlanState.FRESH
    assert client.thread is not threading.current_thread()
    assert planner.counts["asked"] == 1


def test_after_closing_the_loop_still_gets_plans() -> None:
    client = GatedClient()
    client.gate.set()
    planner = Planner(client)
    planner.close()

    assert isinstance(update(planner).last_error, ConnectionFailed)


def test_a_server_that_is_lost_in_between_is_survived() -> None:
    client = GatedClient()
    client.gate.set()
    times = iter(np.arange(1000) * 1.0)
    config = PlannerConfig(max_age_ms=2500.0, period_ms=1.0)
    with Planner(client, config, clock=lambda: next(times)) as planner:
        update(planner)
        assert planner.wait(PATIENCE_S).state is PlanState.FRESH
        client.is_lost = True
        update(planner)
        assert planner.wait(PATIENCE_S).expired  # two more ticks have passed since
        client.is_lost = False
        update(planner)
        assert planner.wait(PATIENCE_S).state is PlanState.FRESH


def test_waiting_ends_without_an_answer() -> None:
    client = GatedClient()
    with Planner(client) as planner:
        assert planner.wait(0.0).state is PlanState.WAITING  # nothing was asked
        update(planner)
        assert planner.wait(0.0).state is PlanState.WAITING
        client.gate.set()
