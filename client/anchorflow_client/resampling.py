"""Resample an anchor to a controller's period."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anchorflow_client.contract.checks import is_number
from anchorflow_client.errors import UsageError

Array = NDArray[np.float64]

ROUNDING = 1e-9
"""Rounding, in periods, by which a duration may exceed a multiple of the period."""


class ResampledAnchor(NamedTuple):
    """An anchor at K moments."""

    times: Array
    """[K] s from the anchor's first sample: 0, period, 2 periods … and the end."""
    positions: Array
    """[K,D]."""
    velocities: Array
    """[K,D]."""
    accelerations: Array
    """[K,D]."""


def resample(
    positions: ArrayLike,
    velocities: ArrayLike,
    accelerations: ArrayLike,
    *,
    dt: float,
    period_s: float,
) -> ResampledAnchor:
    """One anchor at every multiple of `period_s` up to its end, and at the end itself.

    Between two samples the way is the cubic that has their positions and velocities (Hermite's),
    its velocity that cubic's derivative: at the samples both are the anchor's own. An error of
    position is at most |p''''| dt^4 / 384. Accelerations are interpolated linearly.

    Args:
        positions: [T,D] m, T at least 2; of `batch.trajectories[n]`.
        velocities: [T,D] m/s.
        accelerations: [T,D] m/s^2.
        dt: s between two samples, as `batch.durations[n] / (T - 1)`.
        period_s: the controller's.

    Raises:
        UsageError: a shape or a time is wrong.
    """
    p, v, a = _motion(positions, velocities, accelerations)
    for name, value in (("dt", dt), ("period_s", period_s)):
        if not is_number(value) or not 0.0 < value < np.inf:
            raise UsageError(f"{name}: expected s above 0, got {value}")
    times = _times(dt * (len(p) - 1), period_s)
    low = np.minimum((times / dt).astype(int), len(p) - 2)
    u = (times / dt - low)[:, None]
    p_0, p_1, m_0, m_1 = p[low], p[low + 1], dt * v[low], dt * v[low + 1]
    # p(u) = p_0 + m_0 u + c u^2 + d u^3
    c, d = 3 * (p_1 - p_0) - 2 * m_0 - m_1, 2 * (p_0 - p_1) + m_0 + m_1
    return ResampledAnchor(
        times,
        p_0 + u * (m_0 + u * (c + u * d)),
        (m_0 + u * (2 * c + 3 * u * d)) / dt,
        (1 - u) * a[low] + u * a[low + 1],
    )


def _times(duration_s: float, period_s: float) -> Array:
    """Return [K] times: 0, period, … and the duration, once if it is a multiple itself."""
    times = period_s * np.arange(int(duration_s / period_s) + 1, dtype=np.float64)
    if duration_s - times[-1] <= ROUNDING * period_s:
        return times
    return np.concatenate([times, [duration_s]])


def _motion(*fields: ArrayLike) -> list[Array]:
    arrays = [np.asarray(field, dtype=np.float64) for field in fields]
    shape = arrays[0].shape
    if len(shape) != 2 or len(arrays[0]) < 2:
        raise UsageError(f"positions: expected shape [T,D], T at least 2, got {list(shape)}")
    for name, array in zip(("velocities", "accelerations"), arrays[1:], strict=True):
        if array.shape != shape:
            raise UsageError(f"{name}: expected shape {list(shape)}, got {list(array.shape)}")
    return arrays
