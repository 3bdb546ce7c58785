"""Progress along a course: closed forms on a street and round a hairpin."""

from __future__ import annotations

import numpy as np
import pytest

from anchorflow_trajectory.car.course import Course
from anchorflow_trajectory.car.foresight import Driven, Foreseen
from anchorflow_trajectory.car.progress import progress
from anchorflow_trajectory.car.tracking import Array, EgoState
from anchorflow_trajectory.guard.faults import Raster
from anchorflow_trajectory.guard.motion import Car

CAR, WHEELBASE = Car(3.6, 1.0, 0.9), 2.7
ROAD = Raster(np.ones((1, 192, 128), np.float32), (-16.0, 80.0, -32.0, 32.0))
NOBODY = Foreseen(np.zeros((0, 1, 50, 3)), np.zeros((0, 1)), np.zeros((0, 2)), np.zeros((0, 2)))
STEPS: Array = np.arange(41, dtype=np.float64)
STREET = Course(np.array([[0.0, 0.0], [100.0, 0.0]]))


def hairpin(radius: float) -> Course:
    """20 m ahead, half a circle to the left and 20 m back."""
    angle = np.linspace(0.0, np.pi, 60)
    bend = np.stack([20 + radius * np.sin(angle), radius - radius * np.cos(angle)], -1)
    return Course(np.concatenate([[[0.0, 0.0]], bend, [[0.0, 2 * radius]]]))


def test_progress_does_not_jump_between_the_arms_of_a_hairpin() -> None:
    course = hairpin(3.0)
    round_it, _ = progress(course, course.poses(10 + 0.5 * STEPS)[None])
    assert round_it[0] == pytest.approx(20.0, abs=0.3)
    straight = np.stack([10 + 0.8 * STEPS, np.zeros(41), np.zeros(41)], -1)[None]
    way, follows = progress(course, straight)
    assert way == follows == 0.0
    # Nearer to the other arm, 6 m away, a car is still on its own.
    aside = np.stack([5 + 0.2 * STEPS, 5.0 / 40 * STEPS, np.zeros(41)], -1)[None]
    way, follows = progress(course, aside)
    np.testing.assert_allclose(follows, 0.75)
    np.testing.assert_allclose(way, 8.0 * follows)


def test_who_drives_beside_a_course_follows_it_less_the_farther_away() -> None:
    moved = np.stack([0.5 * STEPS, np.zeros(41), np.zeros(41)], -1)
    beside = np.zeros((4, 1, 3))
    beside[:, 0, 1] = 0.0, -3.9, 6.0, -9.0
    poses = moved + beside
    way, follows = progress(STREET, poses)
    np.testing.assert_allclose(follows, [1.0, 1.0, 0.5, 0.0])
    np.testing.assert_allclose(way, 20.0 * follows)


def test_a_plan_that_leaves_its_route_is_worth_less_than_one_that_halts_on_it() -> None:
    start = EgoState(np.zeros(3), 2.0, 0.0, 0.0)
    course = hairpin(6.0)
    seconds = 0.5 * np.arange(1, 9)
    leaves = np.stack([10.0 * seconds, 0 * seconds, 0 * seconds], -1)
    halts = np.stack([np.minimum(2.0 * seconds, 3.0), 0 * seconds, 0 * seconds], -1)
    plans = np.stack([leaves, halts])
    left, halted = (
        Driven.of(plans, start, CAR, ROAD, wheelbase=WHEELBASE, course=course, is_route=True)
        .among(NOBODY)
        .worth()
    )
    assert left < 0.1 * halted
