"""The anchors of a tick: which are followed, and the way left along those that are clear."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import AnchorBatch
from anchorflow_client.errors import InvalidRequest
from anchorflow_client.planner import Plan
from anchorflow_control.anchor_motions import check_motions, references
from anchorflow_control.config import MppiConfig
from anchorflow_control.cost_to_go import OFF_PATH_COST, WayLeft, points_along, ways_along
from anchorflow_control.rollout import Task, clearances

Floats = NDArray[np.float32]
Array = NDArray[np.float64]

KEPT_S = 2.0  # that the way left is kept if the next anchors are not clear
BEYOND = 1.5  # of the longest motion, up to which points of anchors are kept
ON_ROUTE = 0.75  # of the anchors that are followed, if the plan has a route


class Guides:
    """Chooses anchors, and keeps the way left along them."""

    def __init__(self, config: MppiConfig, *, tick_s: float, discs: Floats) -> None:
        """Set up without anchors; discs: [J,3] of the robot's body."""
        self._config, self._tick_s, self._discs = config, tick_s, discs
        self.start_room = np.inf
        """Clearance of the robot to static obstacles at this tick, in m."""
        self.reset()

    def reset(self) -> None:
        """Forget the way left."""
        self._left: tuple[Floats, Array] | None = None
        self._off_path = OFF_PATH_COST
        self._ticks_kept = 0

    def along(
        self, task: Task, anchors: AnchorBatch | Plan | None, place: Array
    ) -> tuple[Task, Floats, list[int]]:
        """Return the task with the way left, references [A,S,5], and the anchors' indices [A].

        Raises `InvalidRequest` if the anchors cannot be followed.
        """
        self._see_start(task)
        self._ticks_kept -= 1
        batch = anchors.batch if isinstance(anchors, Plan) else anchors
        motions, chosen = np.zeros((0, 2, 5), np.float32), np.zeros(0, np.intp)
        if batch is not None and self._config.max_anchors:
            if not isinstance(batch, AnchorBatch):
                came = type(batch).__name__
                raise InvalidRequest(f"expected an AnchorBatch or a Plan, got a {came}", "anchors")
            check_motions(batch)
            chosen = self._chosen(batch, anchors if isinstance(anchors, Plan) else None)
            age_s = 1e-3 * anchors.age_ms if isinstance(anchors, Plan) else 0.0
            motions = references(
                batch,
                chosen,
                place,
                kind=task.limits.kind,
                elapsed_s=age_s - batch.first_s,
                dt=self._config.dt,
                least=self._config.steps + 1,
                heading=float(task.start[2]),
            )
            on_route = anchors.on_route if isinstance(anchors, Plan) else None
            off = np.zeros(len(chosen), np.bool_) if on_route is None else ~on_route[chosen]
            self._measure(task, motions, off, place)
        return task._replace(left=self._way_left(place)), motions, chosen.tolist()

    def _see_start(self, task: Task) -> None:
        self.start_room = float(clearances(task, task.start[None, None], moving=False)[0, 0])

    def _chosen(self, batch: AnchorBatch, plan: Plan | None) -> NDArray[np.intp]:
        """Return the indices [A] of the anchors to follow: the best, spread over routes."""
        most, count = self._config.max_anchors, len(batch.trajectories)
        if plan is None or plan.on_route is None or plan.best is None:
            return batch.top_k(min(most, count), per_route=batch.routes is not None)
        order = batch.top_k(count, per_route=batch.routes is not None)
        own = plan.on_route[order]
        order = np.concatenate([[plan.best], order[own & (order != plan.best)], order[~own]])
        others = int((~own).sum())
        kept = max(round(ON_ROUTE * most), most - others)
        own_count = int(own.sum())
        return np.concatenate([order[: min(kept, own_count)], order[own_count:]])[:most]

    def _measure(
        self, task: Task, motions: Floats, off_route: NDArray[np.bool_], place: Array
    ) -> None:
        """Keep the way left along those of motions [A,S,5] that are clear."""
        ways = np.empty(motions.shape[:2], np.float32)
        surcharge = task.around.surcharge
        ways_along(surcharge, motions, ways)
        dearest = np.float32(surcharge.values.max(initial=0.0))
        self._off_path = OFF_PATH_COST + dearest
        rooms = clearances(task, motions, self._config.margin, moving=False)
        clear = rooms.min(1) >= np.minimum(rooms[:, 0], self._config.margin)
        if not clear.any():
            return
        points = points_along(
            motions[clear],
            ways[clear],
            task.goal,
            handicap=self._config.off_route * off_route[clear],
            reach=BEYOND * float(task.limits.v_max) * self._config.dt * self._config.steps,
        )
        self._left = points, place.copy()
        self._ticks_kept = round(KEPT_S / self._tick_s)

    def _way_left(self, place: Array) -> WayLeft:
        """Return the way left as seen from a place [2]; straight ahead if none is known."""
        if self._left is None or self._ticks_kept <= 0:
            return WayLeft.straight()
        points, seen_from = self._left
        moved = points.copy()
        moved[:2] += (seen_from - place)[:, None].astype(np.float32)
        return WayLeft(moved, WayLeft.sight_of(self._discs), self._off_path)
