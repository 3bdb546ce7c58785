"""The disturbances of MPPI, and the mean of disturbed controls by their costs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_control.dynamics import within
from anchorflow_trajectory.compiled import compiled

Floats = NDArray[np.float32]

BANK = 4  # times as many disturbances are kept as are drawn at a tick
KNOT_S = 0.4  # s between the knots of smooth disturbances
SMALLEST = 0.05  # of the noise, at which a motion is disturbed least
ONE = np.float32(1.0)


class Disturbances:
    """Smooth disturbances of unit size, drawn once; each tick takes others of them.

    Between knots they are linear, as a robot cannot follow white noise far.
    """

    def __init__(self, motions: int, steps: int, *, dt: float, rng: np.random.Generator) -> None:
        count = max(2, 2 + int((steps - 1) * dt / KNOT_S))
        knots = rng.standard_normal((BANK * motions, count, 2), dtype=np.float32)
        at = np.arange(steps) * (dt / KNOT_S)
        low = np.minimum(at.astype(int), count - 2)
        share = (at - low).astype(np.float32)[:, None]
        bank = (1.0 - share) * knots[:, low] + share * knots[:, low + 1]
        bank /= np.sqrt((1.0 - share) ** 2 + share**2)
        scales = np.linspace(SMALLEST, 1.0, len(bank), dtype=np.float32)
        bank *= rng.permutation(scales)[:, None, None]
        self._bank: Floats = bank.astype(np.float32)
        self._rng = rng

    def draw(self, count: int) -> Floats:
        """Return [K,T,2], a stretch of the bank."""
        begin = int(self._rng.integers(len(self._bank) - count + 1))
        return self._bank[begin : begin + count]


@compiled
def disturb(
    means: Floats, disturbances: Floats, noise: Floats, scale: Floats, controls: Floats
) -> None:
    """Write controls [K,T,2] about means [M,T,2], of which each has K / M in turn.

    disturbances: [K,T,2] of unit size; noise: [2], their standard deviation; scale: [2], the
    largest size of the controls
    """
    for k in range(len(controls)):
        mean = means[k % len(means)]
        for t in range(controls.shape[1]):
            for i in range(2):
                value = mean[t, i] + noise[i] * disturbances[k, t, i]
                controls[k, t, i] = within(value, -scale[i], scale[i])


@compiled
def weigh(costs: Floats, controls: Floats, temperature: np.float32, means: Floats) -> None:
    """Write the means [M,T,2] of controls [K,T,2] by exp(-J / temperature), K / M in turn each."""
    count = len(means)
    for m in range(count):
        least = costs[m]
        for k in range(m, len(costs), count):
            least = min(least, costs[k])
        means[m] = np.float32(0.0)
        total = np.float32(0.0)
        for k in range(m, len(costs), count):
            weight = np.exp((least - costs[k]) / temperature)
            if weight < np.float32(1e-6):
                continue
            total += weight
            for t in range(controls.shape[1]):
                means[m, t, 0] += weight * controls[k, t, 0]
                means[m, t, 1] += weight * controls[k, t, 1]
        for t in range(controls.shape[1]):
            means[m, t, 0] /= total
            means[m, t, 1] /= total
