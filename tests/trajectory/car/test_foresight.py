"""What plans are worth among foreseen others: closed forms, and the referee's own verdicts."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from anchorflow_driving.geometry import out_of_frame
from anchorflow_driving.pdm.collisions import LOOKAHEAD_FRAMES, find_contacts
from anchorflow_driving.pdm.traffic import Others
from anchorflow_driving.window import Vehicle
from anchorflow_trajectory.car.foresight import (
    POWER,
    Driven,
    Foreseen,
    _chances,
    foreseen_poses,
    standing_places,
)
from anchorflow_trajectory.car.tracking import PLAN_TIMES, EgoState, Motion, interpolate, track
from anchorflow_trajectory.guard.faults import Raster
from anchorflow_trajectory.guard.motion import Car

VEHICLE = Vehicle(4.6, 1.8)
SPEED, WHEELBASE, AXLE = 8.0, VEHICLE.wheelbase, VEHICLE.rear_axle
CAR = Car(2.3 + AXLE, 2.3 - AXLE, 0.9)
START = EgoState(np.zeros(3), SPEED, 0.0, 0.0)
ROAD = Raster(np.ones((1, 192, 128), np.float32), (-16.0, 80.0, -32.0, 32.0))
HALF = np.array([2.3, 0.9])
NOBODY = Foreseen(np.zeros((0, 1, 50, 3)), np.zeros((0, 1)), np.zeros((0, 2)), np.zeros((0, 2)))


def straight(*speeds: float) -> np.ndarray:
    """Plans that go from SPEED to other speeds at a constant rate."""
    ways = [SPEED * PLAN_TIMES + (v - SPEED) / 4 * PLAN_TIMES**2 / 2 for v in speeds]
    return np.stack([np.stack([way, 0 * way, 0 * way], -1) for way in ways])


def box(x: float, y: float = 0.0, *, speeds: tuple[float, ...] = (0.0,)) -> np.ndarray:
    """A box along x that may drive at several speeds: poses [1, M, 50, 3]."""
    ways = [np.stack([x + v * PLAN_TIMES, y + 0 * PLAN_TIMES, 0 * PLAN_TIMES], -1) for v in speeds]
    return foreseen_poses(np.array([[x, y, 0.0]]), np.stack(ways)[None])


def among(*boxes: np.ndarray, chances: tuple[float, ...] = (1.0,)) -> Foreseen:
    count = len(boxes)
    weights, half = (np.tile(row, (count, 1)) for row in (chances, HALF))
    return replace(NOBODY, poses=np.concatenate(boxes), probabilities=weights, half=half)


def value(
    plans: np.ndarray, foreseen: Foreseen, *, start: EgoState = START, road: Raster = ROAD
) -> np.ndarray:
    return Driven.of(plans, start, CAR, road, wheelbase=WHEELBASE).among(foreseen).worth()


def test_on_a_free_road_a_drive_is_worth_its_length() -> None:
    far, near = value(straight(8.0, 4.0), NOBODY)
    assert far == pytest.approx(1.0)
    lag = 0.7  # m, by which the controller brakes late
    assert near == pytest.approx(((5 * (24 + lag) / 32 + 7) / 12) ** POWER, abs=0.01)


def test_a_drive_into_who_stands_is_worth_nothing_and_one_that_halts_before_is() -> None:
    into, before = value(straight(8.0, 0.0), among(box(30.0)))
    assert into == 0.0
    assert before > 0.5


def test_what_may_be_hit_in_one_mode_of_several_is_worth_the_rest() -> None:
    plan = straight(8.0)
    foreseen = among(box(25.0, speeds=(0.0, 12.0)), chances=(0.25, 0.75))
    clear, ahead = chances(plan, foreseen)
    assert clear == pytest.approx([0.75])
    assert ahead == pytest.approx([0.75])
    twice = among(*[box(25.0, speeds=(0.0, 12.0))] * 2, chances=(0.25, 0.75))
    assert chances(plan, twice)[0] == pytest.approx([0.75**2])


def test_who_comes_from_behind_is_at_fault_himself() -> None:
    clear, _ = chances(straight(8.0), among(box(-12.0, speeds=(14.0,))))
    assert clear == [1.0]


def test_who_is_close_ahead_leaves_no_time() -> None:
    clear, ahead = chances(straight(8.0), among(box(10.5, speeds=(7.0,))))
    assert (clear, ahead) == ([1.0], [0.0])


def test_what_nobody_foresees_to_move_costs_half_and_the_time() -> None:
    standing = replace(NOBODY, standing=np.array([[20.0, 0.5], [25.0, 3.0]]))
    clear, ahead = chances(straight(8.0), standing)
    assert (clear, ahead) == ([0.5], [0.0])
    beside = replace(NOBODY, standing=np.array([[20.0, 1.0]]))
    assert chances(straight(8.0), beside) == ([1.0], [1.0])


def test_cells_of_boxes_are_theirs_and_all_others_stand() -> None:
    cells = np.zeros((1, 192, 128), np.float32)
    cells[0, 120, 64] = cells[0, 100, 64] = 1.0  # x 19.75 and 29.75, y -0.25
    cells[0, 80, 64] = 0.05
    places = standing_places(replace(ROAD, values=cells), np.array([[21.0, 0.0, 0.0]]), HALF[None])
    np.testing.assert_allclose(places, [[29.75, -0.25]])


def test_off_the_road_nothing_is_worth_anything() -> None:
    cells = np.ones((1, 192, 128), np.float32)
    cells[0, :100] = 0.0  # the road ends at x = 30
    on, off = value(straight(0.0, 8.0), NOBODY, road=replace(ROAD, values=cells))
    assert on > 0.0
    assert off == 0.0


def test_others_go_straight_from_pose_to_pose_and_on() -> None:
    poses = box(10.0, speeds=(6.0,))[0, 0]
    np.testing.assert_allclose(poses[:, 0], 10.0 + 0.6 * np.arange(50), atol=1e-9)
    futures = np.stack([10.0 + 6.0 * PLAN_TIMES, 0 * PLAN_TIMES, 0 * PLAN_TIMES], -1)[None, None]
    later = foreseen_poses(np.array([[10.0, 0.0, 0.0]]), futures, from_s=0.7)[0, 0]
    np.testing.assert_allclose(later[:, 0], poses[:, 0] + 4.2, atol=1e-9)


def test_a_plan_that_begins_elsewhere_is_worth_the_same_there() -> None:
    start, plans = np.array([3.0, 1.0, 0.4]), straight(8.0, 0.0)
    foreseen = among(box(25.0, 1.5, speeds=(0.0, 6.0)), chances=(0.5, 0.5))
    poses = np.asarray(out_of_frame(foreseen.poses.astype(np.float64), start))
    here, elsewhere = value(plans, foreseen), replace(foreseen, poses=poses)
    state = replace(START, pose=start)
    there = value(out_of_frame(plans, start), elsewhere, start=state)
    np.testing.assert_allclose(here, there, atol=1e-6)
    assert 0.0 < here[0] < here[1]


def test_the_referee_says_the_same_of_who_is_ahead() -> None:
    rng = np.random.default_rng(0)
    motion, verdicts = tracked(straight(0.0, 4.0, 8.0, 10.0)), set()
    for x, speed in zip(rng.uniform(6.0, 40.0, 40), rng.uniform(0.5, 12.0, 40), strict=True):
        poses = box(x, speeds=(speed,))
        found = np.array(_chances(motion, CAR, among(poses)))
        velocity = np.tile([speed, 0.0], (1, 50, 1))
        others = Others(np.concatenate([poses[0], velocity], -1), 2 * HALF[None], np.zeros(1, "u1"))
        wanted = np.ones((2, 4))
        for look in LOOKAHEAD_FRAMES:
            traffic: Any = SimpleNamespace(vehicle=VEHICLE, others=others)
            contacts = find_contacts(motion, traffic, ahead=look)
            wanted[1, contacts.plan] = 0.0
            wanted[0, contacts.plan[contacts.ahead == 0]] = 0.0
        np.testing.assert_array_equal(found, wanted)
        verdicts |= {tuple(each) for each in found.T.tolist()}
    assert verdicts == {(1.0, 1.0), (1.0, 0.0), (0.0, 0.0)}


def tracked(plans: np.ndarray) -> Motion:
    poses = np.concatenate([np.zeros((len(plans), 1, 3)), plans], 1)
    return track(interpolate(poses), START, wheelbase=WHEELBASE)


def chances(plans: np.ndarray, foreseen: Foreseen) -> tuple[list[float], list[float]]:
    clear, ahead = _chances(tracked(plans), CAR, foreseen)
    return clear.tolist(), ahead.tolist()
