"""The cost of a trajectory: hard limits, and the three styles that a caller weighs.

    J = u_safety S + u_energy E + u_smooth M + H

    S  mean squared shortfall of clearance from a comfortable distance, and soft map costs
    E  mean squared speed over v_max^2: short ways, no detours, no dashes
    M  mean squared jerk over a reference jerk^2
    H  hinges on clearance, speed and acceleration just inside their limits
    u  the weights asked for, cubed and made to sum to 1 again: the corners and the middle of the
       triangle stay, and what lies between leans clearly to one side

Gradients are written out by hand: numpy on one core then takes well under a millisecond for 64
trajectories of 64 samples.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory.cost_fields import CostFields
from anchorflow_trajectory.spline import SplineBasis

FloatArray = NDArray[np.floating]


@dataclass(frozen=True)
class MotionLimits:
    """What every anchor keeps: speed [m/s] and acceleration [m/s^2], over the horizon [s]."""

    v_max: float
    a_max: float
    horizon_s: float


@dataclass(frozen=True)
class CostWeights:
    """Gains of the terms; the defaults make each style visible in the expert's own data."""

    safety: float = 10.0
    energy: float = 8.0
    smooth: float = 1.5
    collision: float = 400.0
    speed: float = 60.0
    acceleration: float = 60.0
    comfort: float = 0.6  # m of clearance from which more is worth nothing
    jerk_scale: float = 3.0  # m/s^3
    contrast: float = 3.0  # power to which the style's weights are raised
    limit_share: float = 0.95  # the hinges start at this share of v_max and a_max

    def stiffer(self, factor: float) -> CostWeights:
        """The same styles, with obstacles and limits that weigh `factor` times as much."""
        return replace(
            self,
            collision=factor * self.collision,
            speed=factor * self.speed,
            acceleration=factor * self.acceleration,
        )


@dataclass(frozen=True)
class TrajectoryCost:
    """Cost of control points [D, M, K] on one scene, with its gradient.

    style: [3] or [M, 3], weights of safety, energy, smooth
    margin: m of clearance that the hard hinge asks for
    """

    basis: SplineBasis
    fields: CostFields
    limits: MotionLimits
    style: FloatArray
    margin: float = 0.05
    weights: CostWeights = CostWeights()

    def value(self, control: FloatArray) -> FloatArray:
        """J of each trajectory: [M]."""
        return self.value_and_gradient(control)[0]

    def value_and_gradient(self, control: FloatArray) -> tuple[FloatArray, FloatArray]:
        """J [M] and its gradient [D, M, K] with respect to the control points."""
        samples = control @ self.basis.stacked
        position, velocity, acceleration, jerk = _quarters(samples)
        slope = np.empty_like(samples)
        on_position, on_velocity, on_acceleration, on_jerk = _quarters(slope)
        leaning = self.style**self.weights.contrast
        safety, energy, smooth = (leaning / leaning.sum(-1, keepdims=True)).T[..., None]
        w, limits = self.weights, self.limits

        cost = self._place(position, safety * w.safety, on_position)
        cost += _squared(velocity, energy * (w.energy / limits.v_max**2), on_velocity)
        cost += _squared(jerk, smooth * (w.smooth / w.jerk_scale**2), on_jerk)
        speed_limit, acceleration_limit = (w.limit_share * m for m in (limits.v_max, limits.a_max))
        cost += _excess(velocity, speed_limit, w.speed, on_velocity)
        on_acceleration[...] = 0.0
        cost += _excess(acceleration, acceleration_limit, w.acceleration, on_acceleration)

        count = position.shape[-1]
        return cost.sum(-1) / count, (slope @ self.basis.stacked.T) / count

    def _place(self, position: FloatArray, safety: FloatArray, slope: FloatArray) -> FloatArray:
        """Cost [M, T] of where the samples lie; writes its derivatives into slope [D, M, T]."""
        x, y = position[0], position[1]
        clearance, along_x, along_y = self.fields.clearance.sample_with_gradient(x, y)
        hard = np.maximum(self.margin - clearance, 0.0)
        lack = np.maximum(1.0 - clearance / self.weights.comfort, 0.0)
        # Beyond one robot-sized intrusion the hinge grows linearly: a deep start must not explode.
        deep = np.minimum(hard, 0.25)
        cost = self.weights.collision * deep * (2.0 * hard - deep) + safety * lack**2
        rate = -2.0 * (self.weights.collision * deep + safety / self.weights.comfort * lack)
        slope[0], slope[1], slope[2:] = rate * along_x, rate * along_y, 0.0
        if self.fields.soft is not None:
            value, soft_x, soft_y = self.fields.soft.sample_with_gradient(x, y)
            cost += safety * value
            slope[0] += safety * soft_x
            slope[1] += safety * soft_y
        return cost


def _quarters(stacked: FloatArray) -> list[FloatArray]:
    """Views of [..., 4 T]; np.split takes a tenth of the whole gradient's time."""
    count = stacked.shape[-1] // 4
    return [stacked[..., k * count : (k + 1) * count] for k in range(4)]


def _squared(samples: FloatArray, gain: FloatArray, slope: FloatArray) -> FloatArray:
    """gain * |samples|^2, [M, T]; writes the derivative into slope [D, M, T]."""
    np.multiply(samples, 2.0 * gain, out=slope)
    return gain * np.einsum("dmt,dmt->mt", samples, samples)


def _excess(samples: FloatArray, limit: float, gain: float, slope: FloatArray) -> FloatArray:
    """gain * max(|samples| - limit, 0)^2 over the planar part; adds the derivative to slope."""
    planar = samples[:2]
    size = np.sqrt(np.einsum("dmt,dmt->mt", planar, planar)) + 1e-9
    excess = np.maximum(size - limit, 0.0)
    slope[:2] += planar * (2.0 * gain * excess / size)
    return gain * excess**2
