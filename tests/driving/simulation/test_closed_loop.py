"""Routes driven in SUMO's traffic."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from anchorflow_driving.drivers import PLAN_TIMES, constant_velocity, idm, stop
from anchorflow_driving.window import Window

for _module in ("sumo", "libsumo"):
    pytest.importorskip(_module, reason=f"{_module} is not installed")


@pytest.fixture(scope="module")
def loop() -> Any:
    from anchorflow_driving.simulation import closed_loop

    return closed_loop


def test_who_goes_straight_on_leaves_the_road_or_hits_somebody(loop: Any) -> None:
    config = loop.ClosedLoopConfig(seed=5, length_m=250.0, seconds=60.0)

    results = [loop.drive_route(constant_velocity, config, index) for index in range(2)]

    assert {result.outcome for result in results} <= {"collision", "off road"}
    assert all(0 < result.driven_m < 250 for result in results)


def test_a_route_is_alike_when_driven_again_and_ends_in_time(loop: Any) -> None:
    config = loop.ClosedLoopConfig(seed=5, seconds=8.0)

    first, second = (loop.drive_route(idm, config, 1) for _ in range(2))

    assert (first.outcome, first.driven_m, first.seconds) == (
        second.outcome,
        second.driven_m,
        second.seconds,
    )
    assert first.seconds <= 8.0
    assert len(first.plan_ms) == round(first.seconds / config.replan_s)


def test_a_driver_sees_itself_where_it_drove_and_no_future(loop: Any) -> None:
    views = []

    def watching(window: Window, times: np.ndarray = PLAN_TIMES) -> np.ndarray:
        with pytest.raises(loop.SimulationError):
            window.recorded(times)
        views.append(window.view)
        return stop(window, times)

    loop.drive_route(watching, loop.ClosedLoopConfig(seed=5, seconds=4.0), 0)

    for before, view in pairwise(views):
        ego = view.tracks[view.ego]
        assert np.isfinite(ego).all()
        # Its rear axle is the origin: where it was 0.5 s ago lies behind it.
        moved = np.linalg.norm(view.state.pose[:2] - before.state.pose[:2])
        assert np.linalg.norm(ego[-1, :2] - ego[-6, :2]) == pytest.approx(moved, abs=0.05)
        assert ego[-1, 0] == pytest.approx(view.vehicle.rear_axle, abs=1e-6)
        assert view.state.speed <= before.state.speed + 0.05
        _, aside = view.route.project(np.zeros(2))
        assert abs(aside) < 3.0
    assert views[-1].state.speed < views[0].state.speed - 2.0
