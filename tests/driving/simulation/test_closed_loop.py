"""Routes driven in SUMO's traffic."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from anchorflow_driving.drivers import PLAN_TIMES, constant_velocity, idm, stop
from anchorflow_driving.geometry import ahead_of, out_of_frame
from anchorflow_driving.log import DrivingLog, read_log, write_log
from anchorflow_driving.window import Scenes, Vehicle, Window

for _module in ("sumo", "libsumo"):
    pytest.importorskip(_module, reason=f"{_module} is not installed")


@pytest.fixture(scope="module")
def loop() -> Any:
    from anchorflow_driving.simulation import closed_loop

    return closed_loop


def test_who_goes_straight_on_leaves_the_road_or_hits_somebody(loop: Any) -> None:
    config = loop.ClosedLoopConfig(seed=5, length_m=250.0, seconds=60.0)

    results = [loop.drive_route(constant_velocity, config, index) for index in range(2)]

    assert {result.outcome for result in results} <= {"collision", "off road", "off route"}
    assert all(0 < result.driven_m < 250 for result in results)
    assert all(result.progress_m <= result.driven_m + 5 for result in results)


def test_a_route_is_alike_when_driven_again_and_ends_in_time(loop: Any) -> None:
    config = loop.ClosedLoopConfig(seed=5, seconds=4.0)

    first, second = (loop.drive_route(idm, config, 1) for _ in range(2))

    assert (first.outcome, first.driven_m, first.seconds) == (
        second.outcome,
        second.driven_m,
        second.seconds,
    )
    assert first.seconds <= 4.0
    assert len(first.plan_ms) == round(first.seconds / config.replan_s)


def test_a_driver_sees_itself_where_it_drove_and_no_future(loop: Any) -> None:
    import libsumo

    views, misses = [], []

    def watching(window: Window, times: np.ndarray = PLAN_TIMES) -> np.ndarray:
        with pytest.raises(loop.SimulationError):
            window.recorded(times)
        view = window.view
        front = ahead_of(view.state.pose, view.vehicle.rear_axle + view.vehicle.length / 2)
        others = [libsumo.vehicle.getPosition(name) for name in libsumo.vehicle.getIDList()]
        misses.append(np.linalg.norm(np.array(others) - front[:2], axis=1).min())
        views.append(view)
        return stop(window, times)

    loop.drive_route(watching, loop.ClosedLoopConfig(seed=5, seconds=4.0), 0)

    assert max(misses) < 0.05  # the others see it where it is

    for before, view in pairwise(views):
        ego = view.tracks[view.ego]
        assert np.isfinite(ego).all()
        # The rear axle is the origin, and its position 0.5 s ago is behind it.
        moved = np.linalg.norm(view.state.pose[:2] - before.state.pose[:2])
        assert np.linalg.norm(ego[-1, :2] - ego[-6, :2]) == pytest.approx(moved, abs=0.05)
        assert ego[-1, 0] == pytest.approx(view.vehicle.rear_axle, abs=1e-6)
        assert view.state.speed <= before.state.speed + 0.05
        _, aside = view.route.project(np.zeros(2))
        assert abs(aside) < 3.0
    assert views[-1].state.speed < views[0].state.speed - 2.0


def test_a_drive_is_kept_as_a_log_of_what_was_seen_and_driven(loop: Any, tmp_path: Path) -> None:
    config = loop.ClosedLoopConfig(seed=5, seconds=4.0)
    views, kept = [], []

    def watching(window: Window, times: np.ndarray = PLAN_TIMES) -> np.ndarray:
        views.append(window.view)
        return idm(window, times)

    result = loop.drive_route(watching, config, 1, keep=kept.append)
    write_log(kept[0], tmp_path / "log.npz")
    log = read_log(tmp_path / "log.npz")

    alone = loop.drive_route(idm, config, 1)
    assert (result.outcome, result.driven_m) == (alone.outcome, alone.driven_m)
    assert (log.name, log.windows) == ("driven-5-00001", 5)
    # Every other plan, at two plans a second.
    for window, (view, later) in zip(Scenes(log), pairwise(views[::2]), strict=False):
        assert window.command == view.command
        np.testing.assert_allclose(window.state.pose, view.state.pose, atol=0.2)
        assert window.state.speed == pytest.approx(view.state.speed, abs=0.3)
        present = [np.isfinite(each.tracks[:, -1, 0]).sum() for each in (window.view, view)]
        assert present[0] == present[1]
        way = np.linalg.norm(later.state.pose[:2] - view.state.pose[:2])
        assert np.linalg.norm(window.recorded(np.array([1.0]))[0, :2]) == pytest.approx(
            way, abs=0.3
        )


def test_who_stands_is_asked_about_less_often(loop: Any) -> None:
    kept: list[DrivingLog] = []

    loop.drive_route(stop, loop.ClosedLoopConfig(seed=5, seconds=20.0), 1, keep=kept.append)

    frames, states = kept[0].window_frame, kept[0].track_state[kept[0].window_ego[0]]
    stands = np.hypot(*states[frames, 3:].T) < 0.3
    assert set(np.diff(frames)[~stands[1:]]) == {10}
    assert set(np.diff(frames)[stands[1:]]) == {40}


@pytest.mark.parametrize("delay_s", [0.1, 0.3])
def test_until_a_late_plan_arrives_the_car_does_what_the_driver_knew(
    loop: Any, delay_s: float
) -> None:
    told: list[tuple[Vehicle, np.ndarray]] = []

    def watching(window: Window, times: np.ndarray = PLAN_TIMES) -> np.ndarray:
        assert window.meanwhile is not None
        told.append((window.vehicle, out_of_frame(window.meanwhile[:, 1:], window.view.state.pose)))
        return (stop if len(told) % 2 else constant_velocity)(window, times)

    kept: list[DrivingLog] = []
    config = loop.ClosedLoopConfig(seed=5, seconds=2.0, delay_s=delay_s)
    loop.drive_route(watching, config, 0, keep=kept.append)

    turned: list[float] = []
    states, late = kept[0].track_state[kept[0].window_ego[0]], round(delay_s / 0.1)
    for index, (vehicle, poses) in enumerate(told[:-1]):
        asked = len(states) - 1 - 5 * (len(told) - index)
        driven, known = states[asked : asked + 11, :2], vehicle.middles(poses[:11])[:, :2]
        away = np.linalg.norm(driven - known, axis=1)
        assert away[: late + 1].max() < 0.02
        turned.append(away[-1])
    assert max(turned) > 0.05  # then the new plan is driven
