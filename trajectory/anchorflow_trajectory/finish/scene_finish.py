"""What is done to splines on one scene: descents, checks, bisection, and measuring them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import BoolArray, FloatArray
from anchorflow_trajectory.cost.trajectory_cost import TrajectoryCost
from anchorflow_trajectory.finish.bisection import bisect_to_safe
from anchorflow_trajectory.finish.certificate import (
    are_safe,
    path_clearance,
    required_clearance,
    verify,
)
from anchorflow_trajectory.finish.control_barrier import ControlBarrier
from anchorflow_trajectory.finish.optimisation_pass import OptimisationPass
from anchorflow_trajectory.finish.refined import Refined, Refinement, numbered
from anchorflow_trajectory.scene import Scene
from anchorflow_trajectory.spline.basis import SplineBasis, Splines
from anchorflow_trajectory.threads import Spread, in_one

AIM_BEYOND = 0.1  # m beyond a certified margin that the descent aims at, so that it is kept

States = tuple[FloatArray, FloatArray, FloatArray]
"""Positions, velocities and accelerations, each [N, T, D]."""


@dataclass(frozen=True)
class SceneFinish:
    """Descends, checks and measures splines on one scene.

    spread: runs ranges of anchors on threads; an anchor's bytes do not depend on it
    """

    scene: Scene
    spread: Spread = field(default=in_one, kw_only=True)

    def cost(self, spec: Refinement) -> TrajectoryCost:
        """Return the cost that the projection descends and that scores and guidance use."""
        scene, margin = self.scene, spec.safety_margin
        if spec.certified_margin > 0.0:
            margin = max(margin, spec.certified_margin + AIM_BEYOND)
        return scene.cost(margin)

    def optimised(
        self,
        optimisation: OptimisationPass,
        cost: TrajectoryCost,
        splines: Splines,
        certified: float,
        barrier: ControlBarrier | None,
    ) -> tuple[Splines, BoolArray]:
        """Return the splines after a pass and the barrier, and which are safe."""
        tried, safe = optimisation.run(
            cost, splines, self.scene.ends, certified_margin=certified, spread=self.spread
        )
        return self.corrected(tried, safe, certified, barrier)

    def corrected(
        self, splines: Splines, safe: BoolArray, certified: float, barrier: ControlBarrier | None
    ) -> tuple[Splines, BoolArray]:
        """Correct the splines that the barrier makes safe; return all, and which are safe."""
        if barrier is None or safe.all():
            return splines, safe
        failed = np.flatnonzero(~safe)
        corrected = barrier.corrected(splines[failed])
        gained = self.are_safe(corrected, barrier.basis, certified)
        safe[failed[gained]] = True
        return splines.replaced(failed[gained], corrected[gained]), safe

    def are_safe(self, splines: Splines, basis: SplineBasis, certified: float) -> BoolArray:
        """Return which splines are safe: [M]."""
        fields = self.scene.cost_fields
        return are_safe(
            splines,
            basis,
            fields.clearance,
            self.scene.motion,
            certified_margin=certified,
            movers=fields.movers,
        )

    def attainable(self, certified: float) -> bool:
        """Whether both ends keep the certified margin: if not, no anchor does."""
        field = self.scene.cost_fields.clearance
        ends = np.stack([self.scene.x_curr[:2], self.scene.x_goal[:2]])
        kept = path_clearance(field, ends[:, None]) >= required_clearance(field, certified)
        return bool(kept.all())

    def bisected(
        self,
        splines: Splines,
        safe: BoolArray,
        cost: TrajectoryCost,
        certified: float,
        route: NDArray[np.intp] | None = None,
    ) -> Splines:
        """Move what is not safe towards what is, on its own route if one is given."""
        return bisect_to_safe(
            splines,
            safe,
            self.scene.ends,
            cost.basis,
            cost.fields.clearance,
            self.scene.motion,
            route=np.zeros(len(splines), np.intp) if route is None else route,
            certified_margin=certified,
            movers=cost.fields.movers,
            spread=self.spread,
        )

    def measured(
        self,
        splines: Splines,
        cost: TrajectoryCost,
        spec: Refinement,
        states: States | None = None,
    ) -> Refined:
        """Return anchors with their scores and verdicts; states: in place of the splines' own."""
        scene = self.scene
        found = cost.basis.states(splines) if states is None else states
        position, velocity, acceleration = (np.ascontiguousarray(s, np.float32) for s in found)
        verdict = verify(
            (position, velocity, acceleration),
            scene.cost_fields.clearance,
            scene.motion,
            certified_margin=spec.certified_margin,
            movers=scene.cost_fields.movers,
            duration=splines.duration,
        )
        scores = -cost.value(splines)
        return Refined(
            position,
            velocity,
            acceleration,
            splines.duration,
            scores,
            verdict.clearance,
            verdict.safe,
            numbered(scene.classes(position, splines.duration), scores),
        )
