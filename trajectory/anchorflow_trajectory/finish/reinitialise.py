"""Re-initialise routes for which no sample is safe."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.finish.certificate import are_safe
from anchorflow_trajectory.routes.search import Route
from anchorflow_trajectory.routes.splines import splines_along
from anchorflow_trajectory.scene import Scene
from anchorflow_trajectory.spline.basis import PLANE, SplineBasis, Splines

Starts = tuple[Splines, NDArray[np.intp]]
"""M splines, and [M] the index of the route that each follows."""

SLOW_STRETCH = 1.5
"""Factor on the duration of a slow copy of a fitted spline."""
STRETCHES = (1.5, 3.0)
"""Durations of starts, in multiples of the least time for the shortest route; less seldom helps."""
DWELLS = (0.3, 0.5)
"""Shares of the duration spent at the route's corners."""
BEND = 0.025
"""Standard deviation of that time about a corner, in shares of the route's length."""
ROOM = 0.35
"""m beyond robot_radius that a second route keeps, to stay clear of corners."""
MAX_REPLACED = 4
"""Anchors of a route that are replaced; the others are bisected towards them."""
REST_STRETCHES = np.geomspace(1.0, 20.0, 48)
"""The same for the smoothest curves between both ends: a fast, heavy robot brakes for long."""
PLACES = 512  # samples of the time law along a route


@dataclass(eq=False)
class Reinitialisation:
    """The anchors of a scene while routes without a safe anchor are restarted.

    route: [N] index of the route that each follows
    lost: indices of the routes that have no safe anchor yet
    """

    splines: Splines
    safe: NDArray[np.bool_]
    route: NDArray[np.intp]
    lost: NDArray[np.intp]
    _failed: list[tuple[Splines, NDArray[np.intp], FloatArray]] = field(default_factory=list)

    def of_lost(self, begun: Splines, along: NDArray[np.intp]) -> Starts:
        """Keep the starts on routes that are still lost."""
        still = np.isin(along, self.lost)
        return begun[still], along[still]

    def take(
        self, tried: Splines, along: NDArray[np.intp], gained: NDArray[np.bool_], cost: FloatArray
    ) -> None:
        """Replace anchors by the cheapest of the `gained` [M] on their route.

        along, cost: [M]
        """
        for each in np.unique(along[gained]):
            found = np.flatnonzero(gained & (along == each))
            cheapest = found[np.argsort(cost[found])][:MAX_REPLACED]
            own = np.flatnonzero(self.route == each)
            places = own[np.argsort(self.safe[own], kind="stable")][: len(cheapest)]
            self.splines = self.splines.replaced(places, tried[cheapest[: len(places)]])
            self.safe[places] = True
        self.lost = self.lost[~np.isin(self.lost, along[gained])]
        self._failed.append((tried, along, cost))

    def nearest(self, most: int) -> Starts:
        """Return the `most` cheapest splines tried on each lost route."""
        tried, along = _joined([(splines, along) for splines, along, _ in self._failed])
        cost = np.concatenate([cost for *_, cost in self._failed])
        own = [np.flatnonzero(along == each) for each in self.lost]
        kept = np.concatenate([places[np.argsort(cost[places])][:most] for places in own])
        return tried[kept], along[kept]

    def refine(self, basis: SplineBasis) -> None:
        """Move the curves from `basis`, their own, to its finer basis."""
        self.splines = basis.refined(self.splines)
        self._failed.clear()


def new_starts(
    scene: Scene, basis: SplineBasis, lost: NDArray[np.intp], *, certified_margin: float
) -> Iterator[Starts]:
    """Yield starts for the `lost` routes, the cheapest to compute first.

    In turn: the route's own spline, driven slowly, if it has this basis; splines along a route with
    more room; the smoothest curve between both ends, for braking; and control points on the route,
    dense at its corners because a B-spline stays in the hulls of five successive points.

    basis: of the splines
    certified_margin: m, with which no anchor was safe
    """
    if basis is scene.basis:
        yield _slowed(scene, basis, scene.route_splines[lost], SLOW_STRETCH), lost
    routes = {int(place): scene.routes[place] for place in lost if place < len(scene.routes)}
    others = scene.route_search.with_slack(ROOM + certified_margin)
    roomy = {route.signature: route for route in others}
    found = {place: roomy.get(route.signature) for place, route in routes.items()}
    again = {place: route for place, route in found.items() if route is not None}
    if again:
        yield _joined([*_paced(scene, basis, again), *_along(scene, basis, again)])
    resting = _resting(scene, basis, certified_margin)
    rest = np.zeros(len(resting), np.intp)
    along = _along(scene, basis, routes if basis.finer is None else {})
    if len(resting) or basis.finer is None:
        yield _joined([*((resting, rest + place) for place in lost), *along])


def _along(scene: Scene, basis: SplineBasis, routes: Mapping[int, Route]) -> Iterator[Starts]:
    """Yield splines with their control points on these routes."""
    duration = _durations(scene, np.array(STRETCHES))
    for place, route in routes.items():
        for dwell in DWELLS:
            splines = basis.rest_curves(scene.ends, duration)
            on_route = _placed(route, basis, dwell)[basis.free]
            splines.control[PLANE, :, basis.free] = on_route.T[:, None]
            yield splines, np.full(len(splines), place)


def _paced(scene: Scene, basis: SplineBasis, routes: Mapping[int, Route]) -> Iterator[Starts]:
    """Yield the splines that `splines_along` fits to these routes, and slow copies."""
    for place, route in routes.items():
        splines = splines_along([route], basis, scene.ends, limits=scene.motion)
        for each in (splines, _slowed(scene, basis, splines, SLOW_STRETCH)):
            yield each, np.array([place])


def _slowed(scene: Scene, basis: SplineBasis, splines: Splines, factor: float) -> Splines:
    """Return the same paths in `factor` times the duration, unless there is a horizon."""
    if scene.motion.horizon_s is not None:
        return splines
    duration, free = splines.duration * factor, basis.free
    control = basis.end_points(scene.ends, duration)
    control[..., free] = splines.control[..., free]
    return Splines(control, duration)


def _placed(route: Route, basis: SplineBasis, dwell: float) -> FloatArray:
    """Return points [K, 2] of a route for control points that are evenly spaced in time."""
    legs = np.diff(route.points, axis=0)
    length = np.hypot(*legs.T)
    legs, length = legs[length > 0.0], length[length > 0.0]
    if not len(legs):
        return np.repeat(route.points[:1], basis.num_control_points, axis=0)
    marks = np.append(0.0, length.cumsum())
    heading = np.arctan2(legs[:, 1], legs[:, 0])
    turn = np.abs((np.diff(heading) + np.pi) % (2 * np.pi) - np.pi)
    at = np.linspace(0.0, marks[-1], PLACES)
    spent = np.ones(PLACES) / PLACES
    if turn.any():
        near = np.exp(-0.5 * ((at[:, None] - marks[1:-1]) / (BEND * marks[-1])) ** 2) @ turn
        spent = (1.0 - dwell) * spent + dwell * near / near.sum()
    passed = np.append(0.0, 0.5 * (spent[1:] + spent[:-1])).cumsum()
    place = np.interp(basis.even * passed[-1], passed, at)
    points = np.concatenate([route.points[:1], route.points[0] + legs.cumsum(0)])
    return np.stack([np.interp(place, marks, axis) for axis in points.T], -1)


def _resting(scene: Scene, basis: SplineBasis, certified_margin: float) -> Splines:
    """Return the smoothest curve between both ends in its least safe duration, if any."""
    curves = basis.rest_curves(scene.ends, _durations(scene, REST_STRETCHES))
    fields = scene.cost_fields
    safe = are_safe(
        curves,
        basis,
        fields.clearance,
        scene.motion,
        certified_margin=certified_margin,
        movers=fields.movers,
    )
    return curves[np.flatnonzero(safe)[:1]]


def _durations(scene: Scene, stretches: FloatArray) -> FloatArray:
    horizon_s = scene.motion.horizon_s
    return scene.reference_s * stretches if horizon_s is None else np.array([horizon_s])


def _joined(parts: list[Starts]) -> Starts:
    control = np.concatenate([splines.control for splines, _ in parts], axis=1)
    duration = np.concatenate([splines.duration for splines, _ in parts])
    return Splines(control, duration), np.concatenate([route for _, route in parts])
