"""Splines along routes: where a search hands over to a descent, or to a flow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory.descent import PLANE, whitening
from anchorflow_trajectory.routes import Route
from anchorflow_trajectory.spline import SplineBasis
from anchorflow_trajectory.time_law import time_along

FloatArray = NDArray[np.floating]

SPREAD = 0.25


@dataclass(frozen=True, eq=False)
class RouteSplines:
    """N splines along R routes.

    control: [D, N, K] control points; route: [N] the place of the route that each follows
    """

    control: NDArray[np.float32]
    route: NDArray[np.intp]


def splines_along(
    routes: Sequence[Route], basis: SplineBasis, *, x_curr: FloatArray, x_goal: FloatArray
) -> NDArray[np.float32]:
    """Control points [D, R, K] of a spline along each of R routes, which meets both ends exactly.

    A smooth time law (`time_along`) leads from the start's speed along the route, over a cruise, to
    the goal's; the least-squares spline smooths what the route has of corners. A heading is that of
    the smoothest curve between both ends.

    Args:
        routes: from x_curr's position to x_goal's; at least one.
        basis: of the horizon.
        x_curr: [3D] p, v, a in m, m/s, m/s^2.
        x_goal: [2D] p, v in m, m/s.

    Raises:
        ValueError: there is no route.
    """
    if not routes:
        raise ValueError("expected at least one route, got none")
    start, goal = x_curr.reshape(3, -1)[:, PLANE], x_goal.reshape(2, -1)[:, PLANE]
    timed = [_timed(route, basis, start[1], goal[1]) for route in routes]
    control = np.repeat(basis.rest_curve(x_curr, x_goal)[:, None], len(routes), axis=1)
    control[PLANE] = basis.fit_positions(np.stack(timed), start.ravel(), goal.ravel())
    return control


def spread_round(
    splines: FloatArray,
    basis: SplineBasis,
    *,
    tries: int,
    rng: np.random.Generator,
    spread: float = SPREAD,
) -> RouteSplines:
    """`tries` splines, shared equally over those of R routes; the first of each route is its own.

    The others are disturbed smoothly, and least near both ends. Where there are fewer tries than
    routes, the first routes have one each.

    Args:
        splines: [D, R, K] control points, one spline a route, the shortest route first.
        basis: theirs.
        tries: N.
        rng: of the disturbance; the same state brings the same splines.
        spread: m, the disturbance's standard deviation at its widest.

    Raises:
        ValueError: `tries` is below 1, or there is no route.
    """
    count = splines.shape[1]
    if tries < 1 or not count:
        raise ValueError(f"expected tries >= 1 and a route, got {tries} and {count} routes")
    route = np.sort(np.arange(tries) % count)
    control = splines[:, route].astype(np.float32)
    free = control[PLANE, :, basis.free]
    noise = rng.normal(0.0, spread, free.shape) @ whitening(basis).T
    noise[:, np.unique(route, return_index=True)[1]] = 0.0
    control[PLANE, :, basis.free] += noise.astype(np.float32)
    return RouteSplines(control, route)


def _timed(
    route: Route, basis: SplineBasis, velocity: FloatArray, last_velocity: FloatArray
) -> FloatArray:
    """Positions [T, 2] along a route, from one velocity [2] m/s to another."""
    if route.length <= 0.0:
        return np.repeat(route.points[:1], basis.num_samples, axis=0).astype(np.float32)
    mean = route.length / basis.horizon_s
    shares = [
        max(0.0, float(speed @ chord) / float(np.linalg.norm(chord)) / mean)
        for speed, chord in (
            (velocity, _leg(route.points)),
            (last_velocity, -_leg(route.points[::-1])),
        )
    ]
    return time_along(route.points, basis.num_samples, start_share=shares[0], goal_share=shares[1])


def _leg(points: FloatArray) -> FloatArray:
    """[2], from the first point to the first that lies elsewhere."""
    away = points - points[0]
    return away[np.flatnonzero(away.any(1))[0]]
