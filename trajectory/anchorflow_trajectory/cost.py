"""The cost of a trajectory: hard limits, and the three styles that a caller weighs.

    J = B + u_safety S + u_energy E + u_smooth M + H

    B  duration over the scene's reference time: whatever the style, nobody waits for ever
    S  mean squared shortfall of clearance from a comfortable distance, soft map costs, and mean
       squared speed: far from obstacles and slow
    E  duration over the reference time, and mean squared p' over the square of the way that v_max
       covers in it: quick and short
    M  mean squared jerk over a reference jerk^2
    H  hinges on clearance, speed and acceleration just inside their limits
    u  the weights asked for, raised to a power and made to sum to 1 again: the corners and the
       middle of the triangle stay, and what lies between leans clearly to one side

Speeds and accelerations count in shares of the limits, durations in shares of the reference time:
a robot of half the speed and a quarter of the acceleration is asked the same in twice the time.

Gradients are written out by hand: numpy on one core then takes well under a millisecond for 64
trajectories of 64 samples.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory.cost_fields import CostFields
from anchorflow_trajectory.spline import SplineBasis, Splines

FloatArray = NDArray[np.floating]

TURN = 4.0 / 3.0  # m in which a robot that may accelerate as it likes reaches its speed smoothly
DEEP = 0.25  # m of intrusion, about a robot's size, beyond which the hinge grows linearly


@dataclass(frozen=True)
class MotionLimits:
    """What every anchor keeps: speed [m/s] and acceleration [m/s^2].

    horizon_s: s that every anchor lasts; None where each has its own duration
    """

    v_max: float
    a_max: float
    horizon_s: float | None = None

    @property
    def jerk_scale(self) -> float:
        """m/s^3 that count as one: of a ramp to v_max at a_max, or over TURN if that is gentler."""
        return min(self.a_max, self.v_max**2 / TURN) ** 2 / self.v_max

    def least_time(self, length: float) -> float:
        """s from rest to rest along a way of so many m, at the limits."""
        if length * self.a_max > self.v_max**2:
            return length / self.v_max + self.v_max / self.a_max
        return 2.0 * (max(length, 0.0) / self.a_max) ** 0.5

    def durations(self, states: FloatArray) -> NDArray[np.float64]:
        """s that states [N, T, 3D + 1] last, [N]: the horizon, or as their log duration says."""
        if self.horizon_s is not None:
            return np.full(len(states), self.horizon_s)
        return np.exp(states[..., -1].mean(-1, dtype=np.float64))


@dataclass(frozen=True)
class CostWeights:
    """Gains of the terms; the defaults make each style visible in the expert's own data."""

    time: float = 2.0
    safety: float = 10.0
    slow: float = 6.0
    quick: float = 8.0
    short: float = 4.0
    smooth: float = 1.0
    collision: float = 400.0
    speed: float = 240.0
    acceleration: float = 540.0
    comfort: float = 0.6  # m of clearance from which more is worth nothing
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
    """Of J: by the control points [D, M, K], and by log duration [M] where those stay."""

    control: FloatArray
    log_duration: FloatArray


@dataclass(frozen=True)
class TrajectoryCost:
    """Cost of splines on one scene, with its gradient.

    style: [3] or [M, 3], weights of safety, energy, smooth
    reference_s: s that durations are measured by, the least that the shortest route takes
    margin: m of clearance that the hard hinge asks for
    """

    basis: SplineBasis
    fields: CostFields
    limits: MotionLimits
    style: FloatArray
    reference_s: float
    margin: float = 0.05
    weights: CostWeights = CostWeights()

    def value(self, splines: Splines) -> FloatArray:
        """J of each trajectory: [M]."""
        return self.value_and_gradient(splines)[0]

    def value_and_gradient(self, splines: Splines) -> tuple[FloatArray, Gradient]:
        """J [M] and its gradient."""
        samples = splines.control @ self.basis.stacked
        position, first, second, third = _quarters(samples)
        slope = np.empty_like(samples)
        on_position, on_first, on_second, on_third = _quarters(slope)
        safety, energy, smooth = self.weights.leaning(self.style).astype(np.float32)[..., None]
        w, limits = self.weights, self.limits
        duration = splines.duration.astype(np.float32)
        pace = 1.0 / duration[:, None]
        # Shares of the limits are p', p'' and p''' times these.
        by_speed, by_acceleration = pace / limits.v_max, pace**2 / limits.a_max
        by_jerk = pace**3 / limits.jerk_scale
        by_way = np.float32(1.0 / (limits.v_max * self.reference_s))

        place = self._place(position, safety * w.safety, on_position)
        slow_gain, short_gain = safety * w.slow * by_speed**2, energy * w.short * by_way**2
        speeds = _squared(first, slow_gain + short_gain, on_first)
        fast = _excess(first, by_speed, w.limit_share, w.speed, on_first)
        on_second[...] = 0.0
        hard = _excess(second, by_acceleration, w.limit_share, w.acceleration, on_second)
        jerk = _squared(third, smooth * w.smooth * by_jerk**2, on_third)

        count = position.shape[-1]
        gained = speeds * (-2.0 * slow_gain / (slow_gain + short_gain + 1e-30)) - 6.0 * jerk
        gained -= fast.rate + 2.0 * hard.rate
        later = (w.time + w.quick * energy[..., 0]) * duration / self.reference_s
        gradient = Gradient((slope @ self.basis.stacked.T) / count, later + gained.sum(-1) / count)
        cost = place + speeds + fast.cost + hard.cost + jerk
        return cost.sum(-1) / count + later, gradient

    def _place(self, position: FloatArray, safety: FloatArray, slope: FloatArray) -> FloatArray:
        """Cost [M, T] of where the samples lie; writes its derivatives into slope [D, M, T]."""
        x, y = position[0], position[1]
        clearance, along_x, along_y = self.fields.clearance.sample_with_gradient(x, y)
        hard = np.maximum(self.margin - clearance, 0.0)
        lack = np.maximum(1.0 - clearance / self.weights.comfort, 0.0)
        deep = np.minimum(hard, DEEP)  # a deep start must not explode
        cost = self.weights.collision * deep * (2.0 * hard - deep) + safety * lack**2
        rate = -2.0 * (self.weights.collision * deep + safety / self.weights.comfort * lack)
        slope[0], slope[1], slope[2:] = rate * along_x, rate * along_y, 0.0
        if self.fields.soft is not None:
            value, soft_x, soft_y = self.fields.soft.sample_with_gradient(x, y)
            cost += safety * value
            slope[0] += safety * soft_x
            slope[1] += safety * soft_y
        return cost


class _Excess(NamedTuple):
    """cost [M, T] beyond a limit, and what it gains a unit of log scale [M, T]."""

    cost: FloatArray
    rate: FloatArray


def _quarters(stacked: FloatArray) -> list[FloatArray]:
    """Views of [..., 4 T]; np.split takes a tenth of the whole gradient's time."""
    count = stacked.shape[-1] // 4
    return [stacked[..., k * count : (k + 1) * count] for k in range(4)]


def _squared(samples: FloatArray, gain: FloatArray, slope: FloatArray) -> FloatArray:
    """gain * |samples|^2, [M, T]; writes the derivative into slope [D, M, T]."""
    np.multiply(samples, 2.0 * gain, out=slope)
    return gain * np.einsum("dmt,dmt->mt", samples, samples)


def _excess(
    samples: FloatArray, scale: FloatArray, share: float, gain: float, slope: FloatArray
) -> _Excess:
    """gain * max(|scale samples| - share, 0)^2 over the planar part; adds to slope [D, M, T].

    scale: [M, 1]
    """
    planar = samples[:2]
    size = np.sqrt(np.einsum("dmt,dmt->mt", planar, planar)) + 1e-9
    scaled = size * scale
    excess = np.maximum(scaled - share, 0.0)
    slope[:2] += planar * (2.0 * gain * excess * scale / size)
    return _Excess(gain * excess**2, 2.0 * gain * excess * scaled)
