"""Ways of a body: searched poses, curves through them, and laws of time along them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from anchorflow_trajectory.bodies.curves import basis_for, fitted
from anchorflow_trajectory.bodies.motion import (
    ALONG,
    BEND,
    COLUMNS,
    HEADING,
    Limits,
    averaged,
    law_along,
    tabulate,
)
from anchorflow_trajectory.bodies.outline import Outline, ground_of
from anchorflow_trajectory.bodies.search import find_way, guide_along
from anchorflow_trajectory.bodies.shots import Target
from anchorflow_trajectory.bodies.wheels import (
    BACKWARD,
    FORWARD,
    STANDING,
    TURNING,
    Wheels,
    arc,
    moves_of,
)
from anchorflow_trajectory.spline.basis import spline_basis

CELL, ORIGIN = 0.1, np.array([-3.0, -3.0])
LIMITS = Limits(v_max=1.0, a_max=1.5, omega_max=2.0, most_bend=np.inf, window=0.3)
SPOT = Wheels(2.0)
CAR = Wheels(2.0, min_radius=1.0, reverse=True, spot=False)
NOWHERE = np.zeros((0, 0), np.float32)


def way_between(
    start: tuple[float, ...], goal: tuple[float, ...], wheels: Wheels, *, heading: bool = True
) -> np.ndarray:
    """[P, 4], on free ground."""
    ground = ground_of(np.zeros((60, 60), bool), 0.1, ORIGIN)
    points = np.linspace(start[:2], goal[:2], 20)
    rest = np.hypot(*(points - points[-1]).T)
    guide = guide_along(points, rest, (30, 30), ORIGIN, 0.2)
    outline = Outline(np.array([[-0.2, -0.2], [0.4, -0.2], [0.4, 0.2], [-0.2, 0.2]]))
    way, _ = find_way(
        ground, outline.corners, outline.reach, moves_of(wheels, cell=CELL, v_max=1.0, a_max=1.5),
        CELL, guide, NOWHERE, np.array(start), STANDING, 0.0,
        Target(np.array(goal), heading, STANDING, 0.0), 2000,
    )  # fmt: skip
    return way


@pytest.mark.parametrize("bend", [0.0, 0.7, -2.0])
def test_an_arc_has_its_curvature(bend: float) -> None:
    poses = arc(np.linspace(0.0, 1.0, 200), bend)
    turned = np.diff(poses[:, 2]) / np.hypot(*np.diff(poses[:, :2], axis=0).T)
    np.testing.assert_allclose(turned, bend, atol=1e-3)
    ahead = np.arctan2(*np.diff(poses[:, :2], axis=0).T[::-1])
    np.testing.assert_allclose(ahead, 0.5 * (poses[1:, 2] + poses[:-1, 2]), atol=1e-6)


def test_a_way_ends_in_its_pose_and_never_slips() -> None:
    way = way_between((-2.0, 0.0, 0.0), (1.0, 1.0, 1.5), CAR)
    np.testing.assert_allclose(way[0, :3], [-2.0, 0.0, 0.0])
    turn = (way[-1, 2] - 1.5 + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose([*way[-1, :2], turn], [1.0, 1.0, 0.0], atol=1e-6)
    legs, middle = np.diff(way[:, :2], axis=0), 0.5 * (way[1:, 2] + way[:-1, 2])
    across = -legs[:, 0] * np.sin(middle) + legs[:, 1] * np.cos(middle)
    assert np.abs(across).max() < 1e-3
    ahead = legs[:, 0] * np.cos(middle) + legs[:, 1] * np.sin(middle)
    assert (np.sign(ahead) == way[1:, 3]).all()
    assert (np.abs(np.diff(way[:, 2])) <= 1.001 * np.abs(ahead) / CAR.min_radius + 1e-6).all()


def test_gears_are_those_that_wheels_have() -> None:
    behind = (-1.5, 0.0, 0.0)
    assert set(way_between((1.0, 0.0, 0.0), behind, SPOT)[1:, 3]) == {FORWARD, TURNING}
    backs = replace(SPOT, reverse=True)
    assert set(way_between((1.0, 0.0, 0.0), behind, backs)[1:, 3]) == {BACKWARD}
    free = way_between((1.0, 0.0, 0.0), behind, SPOT, heading=False)
    assert free[-1, :2] == pytest.approx(behind[:2])


@pytest.mark.parametrize("gear", [FORWARD, BACKWARD])
def test_a_curve_keeps_both_poses_and_its_heading_is_its_direction(gear: int) -> None:
    poses = arc(gear * np.linspace(0.0, 2.0, 40), 0.8)
    basis = basis_for(2.0, CELL)
    control = fitted(poses, basis, gear, fixed_end=True, bend=0.8 * gear)
    fine = spline_basis(400, num_control_points=basis.num_control_points)
    rows = np.empty((1, 400, COLUMNS))
    tabulate(control[None], fine.band(np.float64), gear, 0.0, rows)
    np.testing.assert_allclose(rows[0, [0, -1], 1:4], poses[[0, -1]], atol=1e-6)
    np.testing.assert_allclose(rows[0, 20:-20, BEND], 0.8 * gear, atol=0.1)
    step = np.diff(rows[0], axis=0)
    np.testing.assert_allclose(step[:, HEADING] / step[:, ALONG], rows[0, 1:, BEND], atol=0.05)
    assert rows[0, -1, ALONG] == pytest.approx(2.0, abs=0.01)


def straight(length: float, bend: float = 0.0) -> np.ndarray:
    rows = np.zeros((60, COLUMNS))
    rows[:, ALONG], rows[:, BEND] = np.linspace(0.0, length, 60), bend
    return rows


@pytest.mark.parametrize("begin", [0.0, 0.6])
@pytest.mark.parametrize("length", [0.5, 4.0])
def test_a_law_covers_its_stretch_within_the_limits(length: float, begin: float) -> None:
    law, keeps = law_along(straight(length), False, LIMITS, 1.0, begin, 0.0)
    lasts = law.times[-1] + LIMITS.window
    states = np.array([averaged(law, LIMITS.window, t) for t in np.linspace(0.0, lasts, 2000)])
    assert keeps
    np.testing.assert_allclose(states[[0, -1], 0], [0.0, length], atol=1e-6)
    np.testing.assert_allclose(states[[0, -1], 1], [begin, 0.0], atol=1e-6)
    dt = lasts / 1999
    np.testing.assert_allclose(np.gradient(states[:, 0], dt)[1:-1], states[1:-1, 1], atol=2e-3)
    assert states[:, 1].max() <= LIMITS.v_max + 1e-9
    assert np.abs(states[:, 2]).max() <= LIMITS.a_max


def test_bends_are_driven_slowly() -> None:
    law, _ = law_along(straight(4.0, bend=4.0), False, LIMITS, 1.0, 0.0, 0.0)
    assert law.speeds.max() * 4.0 <= LIMITS.omega_max
    assert law.speeds.max() ** 2 * 4.0 <= LIMITS.a_max


def test_who_is_too_fast_to_stop_is_told_so() -> None:
    _, keeps = law_along(straight(0.2), False, LIMITS, 1.0, 1.0, 0.0)
    assert not keeps
