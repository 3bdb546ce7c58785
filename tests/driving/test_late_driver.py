"""Drivers whose plans arrive late."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from anchorflow_driving.drivers import (
    PLAN_TIMES,
    constant_velocity,
    human,
    route_constant_speed,
    stop,
)
from anchorflow_driving.late_driver import ByTime, LateDriver, MovedOn, begins_s, late_drivers
from anchorflow_driving.moved_on import moved_on
from anchorflow_driving.window import Scenes, Window

OnStreet = Callable[..., Window]


def test_a_window_before_is_what_was_seen_then(on_street: OnStreet) -> None:
    window = on_street(speed=6.0)
    before = window.before(0.5)
    moved = window.state.pose[0] - before.state.pose[0]
    assert moved == pytest.approx(3.0, abs=1e-5)
    assert before.view.route.project(np.zeros(2))[0] == pytest.approx(
        window.view.route.project(np.zeros(2))[0] - moved, abs=1e-4
    )
    assert window.before(2.5).view.tracks.shape == window.view.tracks.shape  # before the log


@pytest.mark.parametrize("delay_s", [0.1, 0.3, 0.5])
def test_by_time_the_record_stays_the_record_and_untold_it_comes_too_late(
    on_street: OnStreet, delay_s: float
) -> None:
    window = on_street(speed=6.0)
    on_time = human(window, PLAN_TIMES)
    for driver in (
        ByTime(human, delay_s),
        ByTime(constant_velocity, delay_s),
        MovedOn(constant_velocity, delay_s),
        MovedOn(route_constant_speed, delay_s),
    ):
        assert begins_s(driver) == delay_s
        np.testing.assert_allclose(LateDriver(driver, delay_s)(window), on_time, atol=1e-4)
    untold = LateDriver(stop, delay_s)(window)
    np.testing.assert_allclose(untold, stop(window), atol=1e-4)  # brakes from where it is
    told = LateDriver(ByTime(stop, delay_s), delay_s)(window)
    assert told[-1, 0] == pytest.approx(untold[-1, 0] - 6.0 * delay_s, abs=1e-4)


def test_a_view_that_is_moved_on_is_what_will_be_seen(street: Any, other: Any) -> None:
    """If everybody keeps their velocity, as on this street."""
    log = street(other(20.0, 0.0, 6.0), other(30.0, 4.0, 8.0, heading=np.pi), speed=8.0)
    window = Scenes(log)[0]
    for meanwhile in (None, window.before(0.3).meanwhile):
        view, true = moved_on(window.before(0.3).view, 0.3, meanwhile), window.view
        np.testing.assert_allclose(view.tracks, true.tracks, atol=1e-4)
        np.testing.assert_allclose(view.state.pose, true.state.pose, atol=1e-4)
        np.testing.assert_allclose(view.route.points, true.route.points, atol=1e-3)
        assert (view.state.speed, view.state.acceleration) == pytest.approx((8.0, 0.0), abs=1e-3)


def test_only_a_bundle_can_be_told() -> None:
    assert late_drivers(stop, "stop", 0.0) == {"stop": stop}
    assert [*late_drivers(stop, "stop", 0.3)] == [
        f"stop_late_300_{how}" for how in ("by_time", "moved_on", "untold")
    ]
