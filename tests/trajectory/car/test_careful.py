"""Careful drives: courses, the intelligent driver model behind others, and the reference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from anchorflow_trajectory.car.by_rule import arcs
from anchorflow_trajectory.car.careful import (
    careful_drives,
    presumed_course,
    reference_progress,
)
from anchorflow_trajectory.car.course import Course
from anchorflow_trajectory.car.following import UNKNOWN_SPEED_LIMIT
from anchorflow_trajectory.car.foresight import Driven, Foreseen, foreseen_poses
from anchorflow_trajectory.car.tracking import PLAN_TIMES, EgoState
from anchorflow_trajectory.guard.faults import Raster
from anchorflow_trajectory.guard.motion import Car

CAR, SPEED, WHEELBASE = Car(3.6, 1.0, 0.9), 8.0, 2.7
START = EgoState(np.zeros(3), SPEED, 0.0, 0.0)
ROAD = Raster(np.ones((1, 192, 128), np.float32), (-16.0, 80.0, -32.0, 32.0))
NOBODY = Foreseen(np.zeros((0, 1, 50, 3)), np.zeros((0, 1)), np.zeros((0, 2)), np.zeros((0, 2)))
STREET = Course(np.array([[0.0, 0.0], [100.0, 0.0]]))


def driven(plans: np.ndarray) -> Driven:
    return Driven.of(plans, START, CAR, ROAD, wheelbase=WHEELBASE, course=STREET)


def leader(x: float, speed: float, *, y: float = 0.0) -> Foreseen:
    now = np.array([[x, y, 0.0]])
    way = np.stack([x + speed * PLAN_TIMES, y + 0 * PLAN_TIMES, 0 * PLAN_TIMES], -1)
    poses, half = foreseen_poses(now, way[None, None]), np.array([[2.3, 0.9]])
    return replace(NOBODY, poses=poses, probabilities=np.ones((1, 1)), half=half)


def test_a_course_round_a_circle_is_as_long_as_its_chords_and_turns_evenly() -> None:
    angle = np.linspace(0.0, np.pi / 2, 200)
    course = Course(30 * np.stack([np.sin(angle), 1 - np.cos(angle)], -1))
    assert course.length == pytest.approx(30 * np.pi / 2, rel=1e-4)
    poses = course.poses(np.array([0.0, 15.0]), 2.0)
    inside = [28 * np.sin(0.5), 30 - 28 * np.cos(0.5), 0.5]
    np.testing.assert_allclose(poses[1], inside, atol=2e-2)
    along, left = course.project(poses[:, :2])
    np.testing.assert_allclose(along, [0.0, 15.0], atol=2e-2)
    np.testing.assert_allclose(left, 2.0, atol=2e-2)


def test_on_a_free_street_the_fastest_drive_reaches_for_the_limit() -> None:
    drives = careful_drives(STREET, START, CAR, NOBODY)
    assert drives.shape == (15, 8, 3)
    ends = drives[:5, -1, 0]
    assert (np.diff(ends) > 0).all()
    assert ends[-1] == pytest.approx(SPEED * 4 + 1.5 * 8, abs=0.7)
    assert ends[-1] < UNKNOWN_SPEED_LIMIT * 4
    assert set(drives[:, -1, 1]) == {0.0, -1.0, 1.0}


def test_nobody_drives_into_who_stands_or_is_foreseen_to() -> None:
    rolling, halting = leader(25.0, SPEED), leader(25.0, SPEED)
    way = np.minimum(SPEED * PLAN_TIMES - PLAN_TIMES**2, 16.0)  # it halts in 4 s
    way[-1] = 16.0
    poses = np.stack([25.0 + way, 0 * way, 0 * way], -1)[None, None]
    halting = replace(halting, poses=foreseen_poses(np.array([[25.0, 0.0, 0.0]]), poses))
    steady, foreseen = (
        careful_drives(STREET, START, CAR, each)[4, -1, 0] for each in (rolling, halting)
    )
    assert foreseen < steady - 1.0
    unlikely = replace(
        halting,
        poses=np.concatenate([rolling.poses, halting.poses], 1),
        probabilities=np.array([[0.6, 0.4]]),
    )
    assert careful_drives(STREET, START, CAR, unlikely)[4, -1, 0] == steady
    post = replace(NOBODY, standing=np.array([[25.0, 0.0]]))
    stops = careful_drives(STREET, START, CAR, post)
    assert stops[:, -1, 0].max() < 25.0 - 0.25 - CAR.front
    beside = replace(NOBODY, standing=np.array([[25.0, 2.5]]))
    free = careful_drives(STREET, START, CAR, NOBODY)
    np.testing.assert_array_equal(careful_drives(STREET, START, CAR, beside), free)


def test_the_reference_is_the_best_of_those_who_see_velocities() -> None:
    free = careful_drives(STREET, START, CAR, NOBODY)
    behind = careful_drives(STREET, START, CAR, leader(20.0, 4.0))
    ways = [
        reference_progress(driven(drives), seen)
        for drives, seen in ((free, NOBODY), (behind, leader(20.0, 4.0)))
    ]
    assert ways[0] == pytest.approx(free[4, -1, 0], abs=1.0)
    assert ways[1] < 20.0 - 2.3 + 16.0 - CAR.front


def test_nothing_is_worth_more_for_going_farther_than_the_reference() -> None:
    far, near = careful_drives(STREET, START, CAR, NOBODY)[[4, 2]]
    plans = np.stack([far, near])
    found = driven(plans).among(NOBODY)
    free, kept = found.worth(), found.worth(reference=near[-1, 0] - 1.0)
    assert free[1] < free[0]
    np.testing.assert_allclose(kept, [1.0, 1.0])


def test_by_rule_others_keep_their_arcs_and_brake_to_a_halt() -> None:
    now, velocity = np.array([[5.0, 1.0, 0.0], [9.0, 2.0, 0.3]]), np.array([[6.0, 0.0], [0.5, 0.0]])
    going = arcs(now, velocity, np.array([0.2, 0.5]))
    turn = 0.2 * PLAN_TIMES
    circle = np.stack([5 + 30 * np.sin(turn), 1 + 30 * (1 - np.cos(turn)), turn], -1)
    np.testing.assert_allclose(going[0], circle, atol=1e-9)
    np.testing.assert_allclose(going[1, :, 2], 0.3)  # so slow a turn is noise
    halting = arcs(now, velocity, np.zeros(2), braking=3.0)
    np.testing.assert_allclose(halting[0, :, 0], 5 + np.array([2.625, 4.5, 5.625] + [6.0] * 5))


def test_without_a_route_the_best_long_plan_leads_on() -> None:
    way = SPEED * PLAN_TIMES
    ahead = np.stack([way, 0 * way, 0 * way], -1)
    left = np.stack([30 * np.sin(way / 30), 30 * (1 - np.cos(way / 30)), way / 30], -1)
    halt = np.zeros((8, 3))
    course = presumed_course(np.stack([ahead, left, halt]), np.array([0.3, 0.5, 0.9]), START)
    along, beside = course.project(left[:, :2])
    np.testing.assert_allclose(beside, 0.0, atol=0.1)  # the corners are cut
    assert along[-1] == pytest.approx(3.0 + 32.0, abs=0.2)
    np.testing.assert_allclose(course.heading[-1], 32 / 30, atol=1e-3)
    stands = presumed_course(halt[None], np.ones(1), START)
    np.testing.assert_allclose(stands.heading, 0.0, atol=1e-9)
