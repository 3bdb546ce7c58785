"""Which routes a scene offers: with its certified margin, and roomy ones where something moves."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.cost.clearance import FINE
from anchorflow_trajectory.routes.homotopy import ObstacleRays
from anchorflow_trajectory.routes.search import SLACK, Route, find_routes
from anchorflow_trajectory.routes.shortening import CHORD_SLACK, pulled_tight

DETOUR = 1.5  # times a tight route that a roomy one may be long


@dataclass(frozen=True, eq=False)
class RouteSearch:
    """Searches the routes of one scene.

    clearance: [H, W] m beyond robot_radius at cell centres; surcharge: [H, W] or None
    resolution: m/cell; origin: [2] m, outer corner of cell (0, 0); start, goal: [2] m
    rays: of this clearance and surcharge
    """

    clearance: FloatArray
    surcharge: FloatArray | None
    resolution: float
    origin: FloatArray
    start: FloatArray
    goal: FloatArray
    rays: ObstacleRays
    _with_slack: dict[float, list[Route]] = field(default_factory=dict)

    def offered(self, margin: float, *, roomy_within: float | None) -> list[Route]:
        """Return the cheapest ways, the cheapest first; none where none is free.

        margin: m that they keep, where any can; if none can be certified, `safe` says so
        roomy_within: m of way up to which roomy routes take the place of others; None: never
        """
        for kept in dict.fromkeys((margin, 0.0)):
            roomy = [] if roomy_within is None else self._roomy(SLACK + kept, roomy_within)
            if found := roomy or self._found(SLACK + kept):
                return self._tight(found, CHORD_SLACK + kept)
        return []

    def with_slack(self, slack: float) -> list[Route]:
        """Return the routes that keep `slack` m beyond robot_radius, if any."""
        if slack not in self._with_slack:
            self._with_slack[slack] = self._tight(self._found(slack), slack)
        return self._with_slack[slack]

    def _roomy(self, slack: float, most: float) -> list[Route]:
        """Return routes of at most `most` m with a cell more of slack, if they are hardly longer.

        A gap that is open by less may be closed on the next map, a fraction of a cell further on,
        and who has to turn round among what moves is late.
        """
        found = self._found(slack + max(self.resolution, FINE))
        roomy = [route for route in found if route.length <= most]
        straight = float(np.linalg.norm(self.goal - self.start))
        if all(route.length <= DETOUR * straight for route in roomy):
            return roomy  # without a look for the others, which are no shorter than straight
        least = self._found(slack)[0].length
        return [route for route in roomy if route.length <= DETOUR * least]

    def _found(self, slack: float) -> list[Route]:
        return find_routes(
            self.clearance,
            resolution=self.resolution,
            origin=self.origin,
            start=self.start,
            goal=self.goal,
            slack=slack,
            rays=self.rays,
            surcharge=self.surcharge,
        )

    def _tight(self, routes: list[Route], slack: float) -> list[Route]:
        return pulled_tight(
            routes,
            self.clearance,
            resolution=self.resolution,
            origin=self.origin,
            slack=slack,
            rays=self.rays,
            surcharge=self.surcharge,
        )
