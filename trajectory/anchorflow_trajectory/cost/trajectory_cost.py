"""The cost of a trajectory: hard limits, and the three styles that a caller weighs.

    J = B + u_safety S + u_energy E + u_smooth M + D + P + H

    B  duration over the scene's reference time: trajectories stay finite in every style
    S  mean squared shortfall of clearance from a comfortable distance, and mean squared speed: far
       from obstacles and slow
    E  duration over the reference time, and mean squared p' over the square of the way that v_max
       covers in it: quick and short
    M  mean squared jerk over a reference jerk^2
    D  the integral of 1 + surcharge along the path, over the way that v_max covers in the
       reference time: dear ground, in every style alike; nothing on a map without surcharge
    P  mean squared shortfall of distance to each thing that moves from a comfortable distance,
       which grows with time, at every second sample: in every style, and more in a safe one
    H  hinges on clearance, also to what moves, speed and acceleration just inside their limits
    u  the requested weights, raised to a power and normalised: the corners and the middle of the
       triangle stay, and points between lean clearly to one side

Speeds and accelerations are relative to the limits, durations to the reference time: a robot of
half the speed and a quarter of the acceleration gets the same cost in twice the time.

The gradients are written out by hand, in `kernels`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import DTypeLike

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.cost.fields import CostFields, Grid
from anchorflow_trajectory.cost.kernels import Gains, Problem, cost_of_splines
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.movers import Discs
from anchorflow_trajectory.spline.basis import SplineBasis, Splines

STEEP = 6.0
"""Surcharge beyond which obstacles and limits weigh more, so that dear ground pushes nobody into
them."""


@dataclass(frozen=True)
class CostWeights:
    """Gains of the terms; the defaults make each style visible in the expert's own data."""

    time: float = 2.0
    safety: float = 10.0
    slow: float = 6.0
    quick: float = 8.0
    short: float = 4.0
    smooth: float = 1.0
    dear: float = 12.0
    near: float = 40.0
    per_s: float = 0.33  # 1/s, of the time spent near what moves
    collision: float = 400.0
    speed: float = 240.0
    acceleration: float = 540.0
    comfort: float = 0.6  # m of clearance from which more is worth nothing
    distance: float = 0.5  # m of clearance to what moves from which more is worth nothing, now
    widening: float = 0.1  # m/s by which that distance grows, since tracks are told by guess
    fading: float = 0.2  # 1/s, how fast what moves counts less, the later it is near
    contrast: float = 3.0  # power to which the style's weights are raised
    limit_share: float = 0.97  # the hinges start at this share of v_max and a_max

    def stiffer(self, factor: float) -> CostWeights:
        """The same styles, with obstacles and limits that weigh `factor` times as much."""
        return replace(
            self,
            collision=factor * self.collision,
            speed=factor * self.speed,
            acceleration=factor * self.acceleration,
        )

    def leaning(self, style: FloatArray) -> FloatArray:
        """u of a style [3] or of styles [M, 3]: [3] or [3, M]."""
        lean = style**self.contrast
        return (lean / lean.sum(-1, keepdims=True)).T


class Gradient(NamedTuple):
    """The gradient of J by control points [D, M, K], and by log duration [M] with these fixed."""

    control: FloatArray
    log_duration: FloatArray


@dataclass(frozen=True)
class TrajectoryCost:
    """Cost of splines on one scene, with its gradient.

    style: [3] or [M, 3], weights of safety, energy, smooth
    reference_s: s that durations are measured by, the least that the shortest route takes
    margin: m of clearance at which the hard hinge begins
    cruise: m/s that take the place of v_max, for who has time to go slower; None: v_max
    """

    basis: SplineBasis
    fields: CostFields
    limits: MotionLimits
    style: FloatArray
    reference_s: float
    margin: float = 0.05
    weights: CostWeights = CostWeights()
    cruise: float | None = None

    def value(self, splines: Splines) -> FloatArray:
        """J of each trajectory: [M]."""
        return self.value_and_gradient(splines)[0]

    def value_and_gradient(self, splines: Splines) -> tuple[FloatArray, Gradient]:
        """J [M] and its gradient."""
        control = np.ascontiguousarray(splines.control)
        cost, slope, by_duration = cost_of_splines(
            self.problem(control.dtype),
            control,
            splines.duration.astype(control.dtype),
            self.leaning(len(splines), control.dtype),
        )
        return cost, Gradient(slope, by_duration)

    def leaning(self, count: int, dtype: DTypeLike) -> FloatArray:
        """u of each of M trajectories: [3, M]."""
        leaning = np.empty((3, count), dtype)
        leaning[:] = self.weights.leaning(self.style).reshape(3, -1)
        return leaning

    def problem(self, dtype: DTypeLike) -> Problem:
        """Return the cost for compiled loops, in numbers of a dtype."""
        w, dear = self.weights, 0.0
        limits = replace(self.limits, v_max=self.cruise or self.limits.v_max)
        if self.fields.surcharge is not None:
            dear, dearest = w.dear, float(self.fields.surcharge.values.max())
            w = w.stiffer(max(1.0, dearest / STEEP))
        gains = (w.time, w.safety, w.slow, w.quick, w.short, w.smooth, dear, w.near, w.per_s)
        gains += (w.collision, w.speed, w.acceleration, w.comfort, w.distance, w.widening, w.fading)
        gains += (w.limit_share, self.margin)
        gains += (limits.v_max, limits.a_max, limits.jerk_scale, self.reference_s)
        return Problem(
            self.basis.band(dtype),
            Grid.of(self.fields.clearance, dtype),
            Grid.of(self.fields.surcharge, dtype),
            self.fields.movers and Discs.of(self.fields.movers, dtype),
            Gains(*np.array(gains, dtype)),
        )
