"""The finish: what `safe` certifies, and what the barrier may and may not do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from anchorflow_trajectory.clearance import clearance_field
from anchorflow_trajectory.cost import MotionLimits
from anchorflow_trajectory.cost_fields import CostFields
from anchorflow_trajectory.refine import Refined, Refiner

LIMITS = MotionLimits(v_max=2.0, a_max=3.0, horizon_s=8.0)
REFINER = Refiner.of(LIMITS, num_steps=64, num_control_points=18, degree=4, steps=20)
BASIS = REFINER.basis
RESOLUTION, RADIUS = 0.1, 0.25
X_CURR = np.asarray([0.8, 3.2, 0.3, 0.0, 0.0, 0.0], np.float32)
X_GOAL = np.asarray([5.6, 3.2, 0.0, 0.0], np.float32)
STYLE = np.asarray([0.0, 1.0, 0.0], np.float32)  # energy: as near to obstacles as it may


@dataclass(frozen=True)
class Spec:
    """What a request asks of the finish."""

    smooth: bool = True
    project: bool = True
    safety_margin: float = 0.1
    barrier: bool = False
    certified_margin: float = 0.0


POSTS = ((10, 22), (32, 38), (54, 60))  # rows; gaps of 1.0 and 1.6 m between them
COLUMNS = (30, 34)


def occupied() -> np.ndarray:
    cells = np.zeros((64, 64), bool)
    for low, high in POSTS:
        cells[low:high, slice(*COLUMNS)] = True
    return cells


def refined(*, x_curr: np.ndarray = X_CURR, steps: int = 20, **spec: Any) -> Refined:
    """64 disturbed curves finished."""
    rng = np.random.default_rng(3)
    control = np.repeat(BASIS.rest_curve(x_curr, X_GOAL)[:, None], 64, axis=1)
    free = control[..., BASIS.free]
    free += rng.normal(0, 0.15, free.shape) * np.sin(np.linspace(0, np.pi, free.shape[-1]))
    free[1] += np.linspace(-2.0, 2.5, 64)[:, None] * np.sin(np.linspace(0, np.pi, free.shape[-1]))
    clearance = clearance_field(occupied(), RESOLUTION, RADIUS)
    cost_map = occupied()[None].astype(np.float32)
    refiner = Refiner(BASIS, LIMITS, steps)
    return refiner.refine(
        np.concatenate(BASIS.states(control), axis=-1),
        CostFields.of(cost_map, clearance, RESOLUTION, np.zeros(2)),
        x_curr=x_curr,
        x_goal=X_GOAL,
        w_style=STYLE,
        spec=Spec(**spec),
    )


def distances(positions: np.ndarray) -> np.ndarray:
    """[M] m from the robot's edge to the nearest post, every 2 mm along each polyline.

    To the posts as rectangles, so without the project's own fields.
    """
    low = RESOLUTION * np.array([(COLUMNS[0], rows[0]) for rows in POSTS])
    high = RESOLUTION * np.array([(COLUMNS[1], rows[1]) for rows in POSTS])
    least = []
    for path in positions.astype(np.float64):
        lengths = np.linalg.norm(np.diff(path, axis=0), axis=1)
        along = np.concatenate([[0.0], np.cumsum(lengths)])
        at = np.linspace(0.0, along[-1], int(along[-1] / 0.002) + 2)
        points = np.stack([np.interp(at, along, path[:, k]) for k in (0, 1)], -1)[:, None]
        gap = np.maximum(np.maximum(low - points, points - high), 0.0)
        least.append(np.linalg.norm(gap, axis=-1).min() - RADIUS)
    return np.array(least)


@pytest.mark.parametrize("margin", [0.0, 0.1, 0.2, 0.3])
@pytest.mark.parametrize("barrier", [False, True])
def test_what_is_safe_keeps_the_certified_margin(margin: float, barrier: bool) -> None:
    anchors = refined(certified_margin=margin, barrier=barrier)
    assert anchors.safe.mean() > 0.9
    assert (anchors.clearance[anchors.safe] >= margin).all()
    assert distances(anchors.positions[anchors.safe]).min() >= margin


@pytest.mark.parametrize(
    ("safety_margin", "certified_margin", "aim"),
    [(0.1, 0.0, 0.1), (0.0, 0.0, 0.0), (0.1, 0.2, 0.3), (0.0, 0.2, 0.3), (0.5, 0.2, 0.5)],
)
def test_the_descent_aims_beyond_what_is_certified(
    safety_margin: float, certified_margin: float, aim: float
) -> None:
    spec = Spec(safety_margin=safety_margin, certified_margin=certified_margin)
    clearance = clearance_field(occupied(), RESOLUTION, RADIUS)
    fields = CostFields.of(occupied()[None], clearance, RESOLUTION, np.zeros(2))
    assert REFINER.cost(fields, w_style=STYLE, spec=spec).margin == pytest.approx(aim, abs=1e-12)


def test_without_a_certified_margin_less_is_kept_than_the_projection_aims_at() -> None:
    """Why there is one: this is what a caller of `safety_margin` cannot rely on."""
    anchors = refined(safety_margin=0.2)
    assert distances(anchors.positions[anchors.safe]).min() < 0.2


def test_where_an_end_is_too_near_no_anchor_is_safe_and_none_is_worse() -> None:
    """The start stands 0.15 m from a post; the projection goes on as if nothing were certified."""
    near = np.asarray([2.6, 3.5, 0.0, 0.0, 0.0, 0.0], np.float32)
    asked, plain = (refined(x_curr=near, steps=1, certified_margin=m) for m in (0.3, 0.0))
    assert not asked.safe.any()
    assert plain.safe.mean() > 0.9
    assert (asked.clearance >= 0.03).mean() > 0.9  # far fewer, were the margin insisted on


def test_the_barrier_takes_no_safe_anchor_away_and_brings_more() -> None:
    """Without descents, which would leave it little to do."""
    without, with_barrier = (refined(project=False, barrier=b) for b in (False, True))
    assert with_barrier.safe[without.safe].all()
    # What was safe stays where it is, and so does what the barrier could not make safe.
    left = without.safe | ~with_barrier.safe
    np.testing.assert_array_equal(with_barrier.positions[left], without.positions[left])
    assert with_barrier.safe.mean() > without.safe.mean() + 0.1


def test_the_barrier_keeps_the_ends_and_the_limits() -> None:
    anchors = refined(steps=1, barrier=True)
    np.testing.assert_allclose(anchors.positions[:, 0], np.tile(X_CURR[:2], (64, 1)), atol=1e-5)
    np.testing.assert_allclose(anchors.positions[:, -1], np.tile(X_GOAL[:2], (64, 1)), atol=1e-5)
    speed = np.linalg.norm(anchors.velocities[anchors.safe], axis=-1)
    assert speed.max() <= 1.02 * LIMITS.v_max
    assert anchors.safe.mean() > 0.9
