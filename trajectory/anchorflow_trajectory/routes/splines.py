"""Splines along routes: the starts of a descent or of a flow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.motion import MotionLimits, nominal_duration, ramp_share, time_along
from anchorflow_trajectory.routes.search import Route
from anchorflow_trajectory.spline.basis import PLANE, Ends, SplineBasis, Splines, whitening

# Standard deviation of disturbances at their widest: a share of the straight line, within bounds in
# m; and that of log duration.
SPREAD_SHARE, LEAST_SPREAD, MOST_SPREAD = 0.05, 0.1, 0.4
STRETCH = 0.1
# Factors by which the weights of safety, energy and smoothness slow down a spline without descent.
PACES = np.array([1.6, 1.0, 1.35])
LEAST_WAY = 0.2  # m that even the shortest counts as


@dataclass(frozen=True, eq=False)
class RouteSplines:
    """N splines along R routes.

    route: [N] the place of the route that each follows
    disturbance: [N, D F + 1] what the free control points in (D, F) order [m] and the log duration
        differ by from the route's own
    """

    splines: Splines
    route: NDArray[np.intp]
    disturbance: NDArray[np.float32]


def splines_along(
    routes: Sequence[Route],
    basis: SplineBasis,
    ends: Ends,
    *,
    limits: MotionLimits,
    leaning: FloatArray | None = None,
) -> Splines:
    """A spline along each of R routes, which meets both ends exactly.

    A smooth time law (`time_along`) leads from the start's speed along the route, over a cruise, to
    the goal's; the least-squares spline smooths what the route has of corners. Each lasts as long
    as the limits and the style make it, or the horizon of the limits. A heading is that of the
    smoothest curve between both ends.

    Args:
        routes: from the start's position to the goal's; at least one.
        basis: of the splines.
        ends: of every one of them.
        limits: speed, acceleration and the horizon, if there is one.
        leaning: [3] shares of safety, energy and smoothness; none: as quick as can be.

    Raises:
        ValueError: there is no route.
    """
    if not routes:
        raise ValueError("expected at least one route, got none")
    pace = 1.0 if leaning is None else float(PACES @ leaning)
    duration = np.array([_duration(route.length, limits, pace) for route in routes])
    timed = [
        _timed(route, basis, ends, limits, float(lasts))
        for route, lasts in zip(routes, duration, strict=True)
    ]
    return splines_through(np.stack(timed), basis, ends, duration)


def splines_through(
    positions: FloatArray, basis: SplineBasis, ends: Ends, duration: FloatArray
) -> Splines:
    """Return the splines nearest to positions [N, T, 2] that meet both ends; duration: [N] s."""
    splines = basis.rest_curves(ends, duration)
    plane = Ends(_planar(ends.x_curr, 3), _planar(ends.x_goal, 2))
    splines.control[PLANE] = basis.fit_positions(positions, plane, duration).control
    return splines


def usual_spread(ends: Ends) -> float:
    """m, the disturbance's standard deviation where it is widest, between these ends."""
    way = float(np.linalg.norm(ends.x_goal[:2] - ends.x_curr[:2]))
    return float(np.clip(SPREAD_SHARE * way, LEAST_SPREAD, MOST_SPREAD))


def spread_round(
    splines: Splines,
    basis: SplineBasis,
    *,
    tries: int,
    rng: np.random.Generator,
    spread: float,
    stretch: float = STRETCH,
) -> RouteSplines:
    """`tries` splines, dealt out in turn over those of R routes; the first of each is its own.

    The others are disturbed smoothly, and least near both ends.

    Args:
        splines: one a route, the shortest route first.
        basis: theirs.
        tries: N.
        rng: of the disturbance; the same state brings the same splines.
        spread: m, the disturbance's standard deviation at its widest (`usual_spread`).
        stretch: standard deviation of log duration; 0 where there is a horizon.

    Raises:
        ValueError: `tries` is below 1, or there is no route.
    """
    count = len(splines)
    if tries < 1 or not count:
        raise ValueError(f"expected tries >= 1 and a route, got {tries} and {count} routes")
    route = np.arange(tries) % count
    control = splines.control[:, route].astype(np.float32)
    noise = np.zeros_like(control[..., basis.free])
    noise[PLANE] = rng.normal(0.0, spread, noise[PLANE].shape) @ whitening(basis).T
    longer = rng.normal(0.0, stretch, tries)
    noise[:, :count], longer[:count] = 0.0, 0.0
    control[..., basis.free] += noise
    disturbance = np.concatenate([noise.swapaxes(0, 1).reshape(tries, -1), longer[:, None]], -1)
    return RouteSplines(
        Splines(control, splines.duration[route] * np.exp(longer)),
        route,
        disturbance.astype(np.float32),
    )


def _planar(states: FloatArray, fields: int) -> FloatArray:
    return states.reshape(fields, -1)[:, PLANE].ravel()


def _duration(length: float, limits: MotionLimits, pace: float) -> float:
    """Return the duration [s] of a spline along a route of `length` m."""
    if limits.horizon_s is not None:
        return limits.horizon_s
    return nominal_duration(max(length, LEAST_WAY), limits, pace=pace)


def _timed(
    route: Route, basis: SplineBasis, ends: Ends, limits: MotionLimits, duration: float
) -> FloatArray:
    """Positions [T, 2] along a route, from one velocity to another."""
    if route.length <= 0.0:
        return np.repeat(route.points[:1], basis.num_samples, axis=0).astype(np.float32)
    mean = route.length / duration
    start, goal = ends.x_curr.reshape(3, -1)[1, PLANE], ends.x_goal.reshape(2, -1)[1, PLANE]
    shares = [
        max(0.0, float(speed @ chord) / float(np.linalg.norm(chord)) / mean)
        for speed, chord in ((start, _leg(route.points)), (goal, -_leg(route.points[::-1])))
    ]
    ramp = ramp_share(duration, route.length, limits)
    return time_along(
        route.points, basis.num_samples, ramp=ramp, start_share=shares[0], goal_share=shares[1]
    )


def _leg(points: FloatArray) -> FloatArray:
    """[2], from the first point to the first that lies elsewhere."""
    away = points - points[0]
    return away[np.flatnonzero(away.any(1))[0]]
