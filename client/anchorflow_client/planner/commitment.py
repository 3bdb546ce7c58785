"""Commitment: a robot stays on its route until another one is better by a margin."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import AnchorBatch
from anchorflow_client.planner.config import PlannerConfig
from anchorflow_client.planner.request import AnchorInUse
from anchorflow_client.planner.routes import Routes

FloatArray = NDArray[np.floating]


class Commitment:
    """The anchor in use, and the route that was given up last because the robot got stuck on it."""

    def __init__(self, config: PlannerConfig) -> None:
        self.in_use: AnchorInUse | None = None
        self._barred: AnchorInUse | None = None
        self._config = config

    def choose(self, batch: AnchorBatch, routes: Routes, seen_at: float) -> int:
        """Index of the anchor to follow: the best one on the route in use.

        Another route is taken where none on it is safe, or where the other's best costs less by
        `switch_gain`. The route that was given up comes last.
        """
        costs = costs_of(batch)
        safe = batch.arrays.get("safe", np.ones(len(costs), np.bool_))
        eligible = safe if safe.any() else np.ones_like(safe)
        barred = self._route(self._barred, routes, seen_at)
        if barred is not None and (eligible & (routes.of != barred)).any():
            eligible = eligible & (routes.of != barred)
        best = _least(costs, eligible)
        kept = self._route(self.in_use, routes, seen_at)
        own = eligible & (routes.of == kept)
        if not own.any():
            return best
        stays = _least(costs, own)
        worth = costs[best] < costs[stays] - self._config.switch_gain * abs(costs[stays])
        return best if worth else stays

    def give_up(self) -> None:
        """The route in use leads nowhere: take another one, and start the next request anew."""
        self._barred, self.in_use = self.in_use, None

    def reset(self) -> None:
        """Forget both."""
        self._barred = self.in_use = None

    @staticmethod
    def _route(anchor: AnchorInUse | None, routes: Routes, now: float) -> int | None:
        left = None if anchor is None else anchor.left(now)
        return None if left is None else routes.route_of(left[:, :2])


def costs_of(batch: AnchorBatch) -> FloatArray:
    """[N] minus the scores or, where there are none, lengths in m."""
    if "scores" in batch.arrays:
        return -batch.scores.astype(np.float64)
    return np.linalg.norm(np.diff(batch.trajectories[..., :2], axis=1), axis=-1).sum(1)


def _least(costs: FloatArray, eligible: NDArray[np.bool_]) -> int:
    return int(np.where(eligible, costs, np.inf).argmin())
