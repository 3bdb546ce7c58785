"""Finish anchors: fit splines that meet both ends, push them clear, and measure what came out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory.cost.clearance import GridField
from anchorflow_trajectory.cost.trajectory_cost import TrajectoryCost
from anchorflow_trajectory.finish.bisection import bisect_to_safe
from anchorflow_trajectory.finish.certificate import (
    are_safe,
    is_one_motion,
    path_clearance,
    required_clearance,
    verify,
)
from anchorflow_trajectory.finish.control_barrier import BETWEEN, ControlBarrier
from anchorflow_trajectory.finish.optimisation_pass import Attempt
from anchorflow_trajectory.finish.reinitialise import Beginnings, Rescue, beginnings
from anchorflow_trajectory.scene import Scene
from anchorflow_trajectory.spline.basis import SplineBasis, Splines
from anchorflow_trajectory.threads import Spread, in_one

FloatArray = NDArray[np.floating]
BoolArray = NDArray[np.bool_]

DESCENT_RATE = 0.3  # m, a first step on the control points
# What has failed is helped along its own way: all of it once, and again where a route has nothing
# safe yet. A hard scene costs more time than an easy one.
FURTHER_RATES = (0.15, 0.15)
STIFFER = 4.0  # by how much obstacles and limits then weigh more, from one to the next
HURRIED = (1.0, 0.9, 0.8, 0.7)  # shares of a duration, of which the cheapest is kept
# Where a route still has nothing safe, it is begun on anew and descended for longer; then so on a
# finer basis, on which the nearest of each route are descended for longer still. The last rate is
# for a robot of 2 m/s and 3 m/s^2: it grows with v_max^2 / a_max, the room that one needs to turn.
RESCUE_STEPS, RESCUE_RATE = 60, 0.1
LONGER_STEPS, MOST_LONGER = 150, 8
TURN, MOST_REACH = 2.0**2 / 3.0, 3.0
AIM_BEYOND = 0.1  # m beyond a certified margin that the descent aims at, so that it is kept


class Refinement(Protocol):
    """What is asked of the finish: the contract's `RefineSpec` is one."""

    @property
    def smooth(self) -> bool:
        """Fit the spline with fixed ends."""
        ...

    @property
    def project(self) -> bool:
        """Push anchors out of obstacles and inside the limits."""
        ...

    @property
    def safety_margin(self) -> float:
        """m of clearance that the projection aims at."""
        ...

    @property
    def barrier(self) -> bool:
        """Correct what is not clear enough by a control barrier."""
        ...

    @property
    def certified_margin(self) -> float:
        """m of clearance beyond the robot's radius that every anchor called safe keeps."""
        ...


@dataclass(frozen=True)
class Refined:
    """Anchors of one scene.

    positions, velocities, accelerations: [N, T, D] in m, m/s, m/s^2
    duration: [N] s
    scores: [N], minus the expert's cost for the requested style; higher is better
    clearance: [N] m beyond robot_radius, smallest along the path
    safe: [N], clear of every obstacle and of the map's edge by the certified margin, and within
        the limits
    """

    positions: FloatArray
    velocities: FloatArray
    accelerations: FloatArray
    duration: FloatArray
    scores: FloatArray
    clearance: FloatArray
    safe: BoolArray


@dataclass(frozen=True)
class Refiner:
    """How the anchors of one scene are finished.

    steps: descents on the control points where a request asks to project; what is not safe then
        is corrected by the barrier, if one is asked for, helped along its own way and brought back
        by bisection
    rate: m, of the first of them
    spread: gives parts of the anchors to threads; an anchor's bytes are the same on any
    """

    scene: Scene
    steps: int
    rate: float = DESCENT_RATE
    spread: Spread = in_one

    def refine(self, states: FloatArray, route: NDArray[np.intp], spec: Refinement) -> Refined:
        """Finish sampled states [N, T, 3D + 1]: p, p', p'' in own time, and log duration.

        Neither smoothed nor projected nor corrected, they are returned as they were sampled.

        route: [N] the place of the route that each follows
        """
        scene = self.scene
        cost = self.cost(spec)
        splines = self.fitted(states)
        field = scene.cost_fields.clearance
        certified = spec.certified_margin if self._attainable(spec, field) else 0.0
        barrier = self._barrier(field, certified) if spec.barrier else None
        if spec.project:
            cost, splines = self._project(cost, splines, route, certified, barrier)
        elif barrier is not None:
            safe = self._safe(splines, cost.basis, certified)
            splines, _ = self._corrected(splines, safe, certified, barrier)
        is_finished = spec.project or spec.smooth or spec.barrier
        if is_finished:
            found = cost.basis.states(splines)
        else:
            found = self._as_sampled(states, splines.duration)
        position, velocity, acceleration = (np.ascontiguousarray(s, np.float32) for s in found)
        verdict = verify(
            (position, velocity, acceleration),
            field,
            scene.motion,
            certified_margin=spec.certified_margin,
        )
        safe = verdict.safe
        if not is_finished:
            sampled = position, velocity, acceleration
            safe &= is_one_motion(sampled, splines.duration, scene.ends, scene.motion)
        return Refined(
            position,
            velocity,
            acceleration,
            splines.duration,
            -cost.value(splines),
            verdict.clearance,
            safe,
        )

    def cost(self, spec: Refinement) -> TrajectoryCost:
        """What the projection descends, the scores tell and guidance follows."""
        scene, margin = self.scene, spec.safety_margin
        if spec.certified_margin > 0.0:
            margin = max(margin, spec.certified_margin + AIM_BEYOND)
        return TrajectoryCost(
            scene.basis, scene.cost_fields, scene.motion, scene.w_style, scene.reference_s, margin
        )

    def fitted(self, states: FloatArray) -> Splines:
        """The splines nearest to states [N, T, 3D + 1]; they last as long as the horizon asks."""
        scene = self.scene
        return scene.basis.fit(states[..., :-1], scene.ends, scene.motion.durations(states))

    @staticmethod
    def _as_sampled(states: FloatArray, duration: FloatArray) -> list[FloatArray]:
        fields = np.split(states[..., :-1], 3, axis=-1)
        return [part / duration[:, None, None] ** order for order, part in enumerate(fields)]

    def _project(
        self,
        cost: TrajectoryCost,
        splines: Splines,
        route: NDArray[np.intp],
        certified: float,
        barrier: ControlBarrier | None,
    ) -> tuple[TrajectoryCost, Splines]:
        """Descend, help along its way what has failed, and bring back what then still fails.

        The cost comes back on the basis of the splines.
        """
        scene, asked = self.scene, cost
        first = Attempt(self.steps, self.rate, shares=HURRIED)
        splines, safe = self._attempted(first, cost, splines, certified, barrier)
        helped = ~safe
        for rate in FURTHER_RATES:
            if not helped.any():
                break
            cost = replace(cost, weights=cost.weights.stiffer(STIFFER))
            failed = np.flatnonzero(helped)
            slowly = Attempt(self.steps, rate, slowed_before=True, slowed_after=True)
            tried, gained = self._attempted(slowly, cost, splines[failed], certified, barrier)
            splines = splines.replaced(failed, tried)
            safe[failed] = gained
            helped = ~safe & ~self._has_any(route[safe])[route]
        sound = np.flatnonzero(safe)
        sound = sound[self._on_route(splines[sound], cost.basis, route[sound])]
        reached = self._has_any(route[sound])
        lost = np.flatnonzero(self._has_any(route) & ~reached)
        if len(lost):
            rescue = Rescue(splines, safe.copy(), route, lost)
            cost = self._rescue(rescue, cost, certified, barrier)
            splines, safe = rescue.splines, rescue.safe
        return replace(asked, basis=cost.basis), bisect_to_safe(
            splines,
            safe,
            scene.ends,
            cost.basis,
            cost.fields.clearance,
            scene.motion,
            route=route,
            certified_margin=certified,
            spread=self.spread,
        )

    def _rescue(
        self, rescue: Rescue, cost: TrajectoryCost, certified: float, barrier: ControlBarrier | None
    ) -> TrajectoryCost:
        """Begin anew on each of the lost routes; the cost, on the basis of the splines by then."""
        self._begin_anew(rescue, cost, certified, barrier)
        finer = cost.basis.finer
        if finer is None or not len(rescue.lost):
            return cost
        rescue.refine(cost.basis)
        cost, barrier = replace(cost, basis=finer), barrier and replace(barrier, basis=finer)
        self._begin_anew(rescue, cost, certified, barrier)
        if len(rescue.lost):
            motion, nearest = self.scene.motion, rescue.nearest(MOST_LONGER)
            reach = min(max(motion.v_max**2 / motion.a_max / TURN, 1.0), MOST_REACH)
            longer = Attempt(LONGER_STEPS, reach * RESCUE_RATE, slowed_after=True)
            self._try(longer, rescue, nearest, cost, certified, barrier)
        return cost

    def _begin_anew(
        self, rescue: Rescue, cost: TrajectoryCost, certified: float, barrier: ControlBarrier | None
    ) -> None:
        """Try what the lost routes may be begun on, until none is lost."""
        scene, attempt = self.scene, Attempt(RESCUE_STEPS, RESCUE_RATE, slowed_after=True)
        for begun in beginnings(scene, cost.basis, rescue.lost, certified_margin=certified):
            self._try(attempt, rescue, rescue.of_lost(*begun), cost, certified, barrier)
            if not len(rescue.lost):
                break

    def _try(
        self,
        attempt: Attempt,
        rescue: Rescue,
        begun: Beginnings,
        cost: TrajectoryCost,
        certified: float,
        barrier: ControlBarrier | None,
    ) -> None:
        """Keep what is safe on its route after the attempt."""
        splines, along = begun
        tried, safe = self._attempted(attempt, cost, splines, certified, barrier)
        gained = safe & self._on_route(tried, cost.basis, along)
        rescue.take(tried, along, gained, cost.value(tried))

    def _has_any(self, route: NDArray[np.intp]) -> BoolArray:
        """Which of the scene's routes are among these: [R]."""
        found = np.zeros(len(self.scene.route_splines), np.bool_)
        found[route] = True
        return found

    def _on_route(self, splines: Splines, basis: SplineBasis, route: NDArray[np.intp]) -> BoolArray:
        """Which still pass the obstacles on the same sides as their route: [M]."""
        scene = self.scene
        if len(scene.routes) < 2:
            return np.ones(len(splines), np.bool_)
        positions = splines.control.transpose(1, 0, 2) @ basis.position.T
        found = scene.rays.signatures(
            positions[:, :2].swapaxes(1, 2), resolution=scene.resolution, origin=scene.origin
        )
        kept = [a == scene.routes[k].signature for a, k in zip(found, route, strict=True)]
        return np.array(kept, np.bool_)

    def _attempted(
        self,
        attempt: Attempt,
        cost: TrajectoryCost,
        splines: Splines,
        certified: float,
        barrier: ControlBarrier | None,
    ) -> tuple[Splines, BoolArray]:
        """The splines after an attempt, corrected by the barrier; and which are safe."""
        tried, safe = attempt.run(
            cost, splines, self.scene.ends, certified_margin=certified, spread=self.spread
        )
        return self._corrected(tried, safe, certified, barrier)

    def _corrected(
        self, splines: Splines, safe: BoolArray, certified: float, barrier: ControlBarrier | None
    ) -> tuple[Splines, BoolArray]:
        """Those corrected that the barrier, if there is one, makes safe; and which then are."""
        if barrier is None or safe.all():
            return splines, safe
        failed = np.flatnonzero(~safe)
        corrected = barrier.corrected(splines[failed])
        gained = self._safe(corrected, barrier.basis, certified)
        safe[failed[gained]] = True
        return splines.replaced(failed[gained], corrected[gained]), safe

    def _safe(self, splines: Splines, basis: SplineBasis, certified: float) -> BoolArray:
        scene = self.scene
        return are_safe(
            splines,
            basis,
            scene.cost_fields.clearance,
            scene.motion,
            certified_margin=certified,
        )

    def _barrier(self, field: GridField, certified: float) -> ControlBarrier:
        return ControlBarrier(
            self.scene.basis, field, required_clearance(field, certified) + BETWEEN
        )

    def _attainable(self, spec: Refinement, field: GridField) -> bool:
        """Whether both ends keep the certified margin themselves.

        Where one does not, no anchor is safe, and the projection does what it does without one.
        """
        required = required_clearance(field, spec.certified_margin)
        ends = np.stack([self.scene.x_curr[:2], self.scene.x_goal[:2]])
        return bool((path_clearance(field, ends[:, None]) >= required).all())
