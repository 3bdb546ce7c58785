"""Finish anchors: fit splines that meet both ends, push them clear, and measure the result."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import BoolArray, FloatArray
from anchorflow_trajectory.cost.clearance import GridField
from anchorflow_trajectory.cost.trajectory_cost import TrajectoryCost
from anchorflow_trajectory.finish.beside import DODGE, FEW, STIFFER, best_beside, is_close_call
from anchorflow_trajectory.finish.certificate import is_one_motion, required_clearance
from anchorflow_trajectory.finish.control_barrier import BETWEEN, ControlBarrier
from anchorflow_trajectory.finish.optimisation_pass import OptimisationPass
from anchorflow_trajectory.finish.refined import Refined, Refinement
from anchorflow_trajectory.finish.reinitialise import Reinitialisation, Starts, new_starts
from anchorflow_trajectory.finish.scene_finish import SceneFinish, States
from anchorflow_trajectory.spline.basis import SplineBasis, Splines

DESCENT_RATE = 0.3  # m, a first step on the control points
# Anchors that are not safe get a further pass each: all of them once, then those of routes that
# have no safe anchor yet. A hard scene costs more time than an easy one.
FURTHER_RATES = (0.15, 0.15)
# Where something moves among walls such a pass is long, and as many get it as may then be safe. In
# the open, with people alone, more robots collided with long passes.
FURTHER_STEPS, FURTHER_MOST = 50, 32
HURRIED = (1.0, 0.9, 0.8, 0.7)  # shares of a duration, of which the cheapest is kept
# A route that still has no safe anchor gets new starts and longer passes, first on this basis, then
# on a finer one, and there the cheapest starts of each route get the longest pass. Its rate is for
# a robot of 2 m/s and 3 m/s^2 and grows with v_max^2 / a_max, the room needed to turn.
RESTART_STEPS, RESTART_RATE = 60, 0.1
LONGER_STEPS = 150
MOST_LONGER, MOST_BESIDE = 8, 2  # starts of a route that get it; beside other routes that are safe
POLISH = OptimisationPass(RESTART_STEPS, RESTART_RATE, shares=HURRIED)
TURN, MOST_REACH = 2.0**2 / 3.0, 3.0


@dataclass(frozen=True)
class Refiner(SceneFinish):
    """Finishes the anchors of one scene.

    steps: descent steps of the first pass if a request projects; anchors that are not safe after it
        are corrected by the barrier if the request has one, optimised further and bisected
    rate: m, of the first step
    """

    steps: int
    rate: float = DESCENT_RATE

    def refine(self, states: FloatArray, route: NDArray[np.intp], spec: Refinement) -> Refined:
        """Finish sampled states [N, T, 3D + 1]: p, p', p'' in own time, and log duration.

        Without smoothing, projection and barrier they are returned as they were sampled.

        route: [N] index of the route that each follows
        """
        scene = self.scene
        cost = self.cost(spec)
        splines = self.fitted(states)
        field = scene.cost_fields.clearance
        certified = spec.certified_margin if self.attainable(spec.certified_margin) else 0.0
        barrier = self._barrier(field, certified) if spec.barrier else None
        share = 1.0
        if spec.project:
            cost, splines, share = self._project(cost, splines, route, certified, barrier)
        elif barrier is not None:
            safe = self.are_safe(splines, cost.basis, certified)
            splines, _ = self.corrected(splines, safe, certified, barrier)
        is_finished = spec.project or spec.smooth or spec.barrier
        if is_finished:
            refined = self.measured(splines, cost, spec)
        else:
            found = self._as_sampled(states, splines.duration)
            refined = self.measured(splines, cost, spec, found)
            is_one = is_one_motion(found, splines.duration, scene.ends, scene.motion)
            refined = replace(refined, safe=refined.safe & is_one)
        if scene.movers is None or not spec.project:
            return refined
        if share < FEW or not refined.safe.any() or is_close_call(self, refined):
            return best_beside(self, refined, spec, len(states))
        return refined

    def fitted(self, states: FloatArray) -> Splines:
        """Return the splines nearest to states [N, T, 3D + 1]; a horizon sets their duration."""
        scene = self.scene
        return scene.basis.fit(states[..., :-1], scene.ends, scene.motion.durations(states))

    @staticmethod
    def _as_sampled(states: FloatArray, duration: FloatArray) -> States:
        position, velocity, acceleration = np.split(states[..., :-1], 3, axis=-1)
        pace = 1.0 / duration[:, None, None]
        return position, velocity * pace, acceleration * pace**2

    def _project(
        self,
        cost: TrajectoryCost,
        splines: Splines,
        route: NDArray[np.intp],
        certified: float,
        barrier: ControlBarrier | None,
    ) -> tuple[TrajectoryCost, Splines, float]:
        """Optimise, restart routes without a safe anchor, and bisect what is still not safe.

        Return the cost on the splines' basis, the splines, and the share that needed no bisection.
        """
        scene, asked = self.scene, cost
        first = OptimisationPass(self.steps, self.rate, shares=HURRIED)
        splines, safe = self.optimised(first, cost, splines, certified, barrier)
        helped = ~safe
        steps, most = self.steps, None
        if scene.movers is not None and scene.occupied.any():
            steps, most = FURTHER_STEPS, FURTHER_MOST
        for rate in FURTHER_RATES:
            left = len(splines) if most is None else max(most - int(safe.sum()), 0)
            failed = np.flatnonzero(helped)[:left]
            if not len(failed):
                break
            cost = replace(cost, weights=cost.weights.stiffer(STIFFER))
            slowly = OptimisationPass(steps, rate, slowed_before=True, slowed_after=True)
            tried, gained = self.optimised(slowly, cost, splines[failed], certified, barrier)
            splines = splines.replaced(failed, tried)
            safe[failed] = gained
            helped = ~safe & ~self._has_any(route[safe])[route]
        sound = np.flatnonzero(safe)
        sound = sound[self._on_route(splines[sound], cost.basis, route[sound])]
        reached = self._has_any(route[sound])
        lost = np.flatnonzero(self._has_any(route) & ~reached)
        if scene.ways.others is not None:  # many ways past what moves are impossible
            lost = lost[:0]
            if not len(sound):
                splines, safe = self._dodged(splines, safe, cost, certified, barrier)
        if len(lost) and self.attainable(certified):
            restart = Reinitialisation(splines, safe.copy(), route, lost)
            cost = self._reinitialise(restart, cost, certified, barrier)
            splines, safe = restart.splines, restart.safe
        moved = self.bisected(splines, safe, cost, certified, route)
        return replace(asked, basis=cost.basis), moved, float(safe.mean())

    def _dodged(
        self,
        splines: Splines,
        safe: BoolArray,
        cost: TrajectoryCost,
        certified: float,
        barrier: ControlBarrier | None,
    ) -> tuple[Splines, BoolArray]:
        """Replace anchors, none of which is safe, by other ways past what moves that are."""
        others = self.scene.ways.others
        assert others is not None
        tried, gained = self.optimised(DODGE, cost, others, certified, barrier)
        found = np.flatnonzero(gained)[: len(splines)]
        places = np.arange(len(found))
        safe[places] = True
        return splines.replaced(places, tried[found]), safe

    def _reinitialise(
        self,
        restart: Reinitialisation,
        cost: TrajectoryCost,
        certified: float,
        barrier: ControlBarrier | None,
    ) -> TrajectoryCost:
        """Restart each lost route; return the cost on the basis that the splines then have."""
        self._try_starts(restart, cost, certified, barrier)
        finer = cost.basis.finer
        if finer is None or not len(restart.lost):
            return cost
        restart.refine(cost.basis)
        cost, barrier = replace(cost, basis=finer), barrier and replace(barrier, basis=finer)
        self._try_starts(restart, cost, certified, barrier)
        if len(restart.lost):
            most = MOST_BESIDE if restart.safe.any() else MOST_LONGER
            motion, nearest = self.scene.motion, restart.nearest(most)
            reach = min(max(motion.v_max**2 / motion.a_max / TURN, 1.0), MOST_REACH)
            longer = OptimisationPass(LONGER_STEPS, reach * RESTART_RATE, slowed_after=True)
            self._try(longer, restart, nearest, cost, certified, barrier)
        return cost

    def _try_starts(
        self,
        restart: Reinitialisation,
        cost: TrajectoryCost,
        certified: float,
        barrier: ControlBarrier | None,
    ) -> None:
        """Try new starts until no route is lost."""
        scene, optimisation = (
            self.scene,
            OptimisationPass(RESTART_STEPS, RESTART_RATE, slowed_after=True),
        )
        for begun in new_starts(scene, cost.basis, restart.lost, certified_margin=certified):
            self._try(optimisation, restart, restart.of_lost(*begun), cost, certified, barrier)
            if not len(restart.lost):
                break

    def _try(
        self,
        optimisation: OptimisationPass,
        restart: Reinitialisation,
        begun: Starts,
        cost: TrajectoryCost,
        certified: float,
        barrier: ControlBarrier | None,
    ) -> None:
        """Optimise starts and keep those that are then safe on their own route."""
        splines, along = begun
        tried, safe = self.optimised(optimisation, cost, splines, certified, barrier)
        gained = safe & self._on_route(tried, cost.basis, along)
        tried = self._polished(tried, along, gained, cost, certified, barrier)
        restart.take(tried, along, gained, cost.value(tried))

    def _polished(
        self,
        tried: Splines,
        along: NDArray[np.intp],
        gained: BoolArray,
        cost: TrajectoryCost,
        certified: float,
        barrier: ControlBarrier | None,
    ) -> Splines:
        """Descend on from what was gained [M], where that is safe, on its route, and cheaper."""
        kept = np.flatnonzero(gained)
        if not len(kept):
            return tried
        found, safe = self.optimised(POLISH, cost, tried[kept], certified, barrier)
        better = safe & self._on_route(found, cost.basis, along[kept])
        better &= cost.value(found) < cost.value(tried[kept])
        return tried.replaced(kept[better], found[better])

    def _has_any(self, route: NDArray[np.intp]) -> BoolArray:
        """Return which of the scene's R routes occur in `route`: [R]."""
        found = np.zeros(len(self.scene.route_splines), np.bool_)
        found[route] = True
        return found

    def _on_route(self, splines: Splines, basis: SplineBasis, route: NDArray[np.intp]) -> BoolArray:
        """Return which splines pass the obstacles on the same sides as their route: [M]."""
        scene = self.scene
        if len(scene.routes) < 2 or scene.movers is not None:
            return np.ones(len(splines), np.bool_)
        positions = splines.control.transpose(1, 0, 2) @ basis.position.T
        found = scene.rays.signatures(
            positions[:, :2].swapaxes(1, 2), resolution=scene.resolution, origin=scene.origin
        )
        kept = [a == scene.routes[k].signature for a, k in zip(found, route, strict=True)]
        return np.array(kept, np.bool_)

    def _barrier(self, field: GridField, certified: float) -> ControlBarrier:
        return ControlBarrier(
            self.scene.basis, field, required_clearance(field, certified) + BETWEEN
        )
