"""Drives along a course: constant accelerations, bends, and how they join their path."""

from __future__ import annotations

import numpy as np

from anchorflow_trajectory.car.course import Course
from anchorflow_trajectory.car.route_drives import OFFSETS, RATES, route_drives
from anchorflow_trajectory.car.tracking import PLAN_TIMES

STREET = Course(np.array([[0.0, 0.0], [100.0, 0.0]]))
CENTRE = OFFSETS.index(0.0) * len(RATES)


def test_a_drive_keeps_its_rate_until_it_stands_or_has_the_top_speed() -> None:
    drives = route_drives(STREET, 6.0, top_speed=9.0)
    assert drives.shape == (len(OFFSETS) * len(RATES), 8, 3)
    for rate, drive in zip(RATES, drives[CENTRE:], strict=False):
        bound = ((9.0 if rate > 0 else 0.0) - 6.0) / rate if rate else np.inf
        time = np.minimum(PLAN_TIMES, bound)
        way = 6.0 * time + rate / 2 * time**2 + np.maximum(PLAN_TIMES - bound, 0) * 9.0 * (rate > 0)
        np.testing.assert_allclose(drive[:, 0], way, atol=0.35)  # steps of 0.1 s
        np.testing.assert_allclose(drive[:, 1:], 0.0, atol=1e-9)


def test_a_drive_joins_its_path_and_turns_as_it_moves() -> None:
    beside = Course(np.array([[-10.0, -2.0], [100.0, -2.0]]))
    drives = route_drives(beside, 8.0, top_speed=10.0)
    for offset, drive in zip(OFFSETS, drives[:: len(RATES)], strict=True):
        assert abs(drive[-1, 1] - (offset - 2.0)) < 0.01
        legs = np.diff(drive, axis=0)
        slope = np.arctan2(legs[:, 1], legs[:, 0])
        between = (drive[1:, 2] + drive[:-1, 2]) / 2
        np.testing.assert_allclose(between, slope, atol=0.05)
        assert abs(drive[0, 1]) < 1.0  # it does not jump


def test_bends_limit_the_speed_and_are_braked_for() -> None:
    angle = np.linspace(0.0, np.pi / 2, 60)
    bend = 20.0 * np.array([[1.0, 0.0]]) + 10.0 * np.stack([np.sin(angle), 1 - np.cos(angle)], -1)
    course = Course(np.concatenate([[[0.0, 0.0]], bend, bend[-1:] + np.array([0.0, 60.0])]))
    drive = route_drives(course, 10.0, top_speed=12.0)[CENTRE]
    place, _ = course.project(drive[:, :2])
    speed = np.diff(place) / 0.5
    inside = (place[:-1] > 21.0) & (place[1:] < 34.0)
    assert inside.any()
    assert speed[inside].max() < 1.1 * np.sqrt(2.0 * 10.0)
    assert -np.diff(speed).min() / 0.5 < 3.5
