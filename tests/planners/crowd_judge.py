"""An independent judge of motions among discs that move, in continuous time.

It works from the fields of a request and from sampled states, and imports nothing of the project.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline


@dataclass(frozen=True)
class Crowd:
    """M discs: knots [M, K + 1, 2] m every `step_s`, radius [M] m, growth m/s."""

    knots: np.ndarray
    radius: np.ndarray
    step_s: float = 1.0
    growth: float = 0.0

    @staticmethod
    def of(
        position: Any,
        velocity: Any = None,
        radius: Any = 0.3,
        *,
        forecast: Any = None,
        forecast_dt: float = 1.0,
        growth: float = 0.0,
    ) -> Crowd:
        """Build a crowd from the fields of `obstacles`."""
        position = np.asarray(position, float)
        ahead = (position + np.asarray(velocity))[:, None] if forecast is None else forecast
        knots = np.concatenate([position[:, None], ahead], axis=1)
        radii = np.broadcast_to(np.asarray(radius, float), len(knots))
        return Crowd(knots, radii, 1.0 if forecast is None else forecast_dt, growth)

    def places(self, times: np.ndarray) -> np.ndarray:
        """[M, T, 2] m at times [T] s; beyond the last knot discs keep their last velocity."""
        at = self.step_s * np.arange(self.knots.shape[1])
        beyond = np.maximum(times - at[-1], 0.0)[:, None] / self.step_s
        inside = np.array([[np.interp(times, at, c) for c in disc.T] for disc in self.knots])
        return inside.swapaxes(1, 2) + beyond * (self.knots[:, -1:] - self.knots[:, -2:-1])

    def gap(self, times: np.ndarray, path: np.ndarray) -> float:
        """Return the least m between the edges of the discs and a path [T, 2] at times [T].

        The times are so dense that both are straight from one to the next.
        """
        off = path - self.places(times)
        begin, along = off[:, :-1], np.diff(off, axis=1)
        square = (along**2).sum(-1)
        share = -(begin * along).sum(-1) / np.where(square > 0.0, square, 1.0)
        nearest = begin + np.clip(share, 0.0, 1.0)[..., None] * along
        middle = 0.5 * (times[:-1] + times[1:])
        radius = self.radius[:, None] + self.growth * middle
        return float((np.hypot(nearest[..., 0], nearest[..., 1]) - radius).min())

    def dense(self, duration: float, step_s: float) -> np.ndarray:
        """Return times [T] from 0 to `duration`, and the knots among them."""
        times = np.linspace(0.0, duration, int(np.ceil(duration / step_s)) + 1)
        at = self.step_s * np.arange(self.knots.shape[1])
        return np.union1d(times, at[at < duration])


def answered_gap(
    crowd: Crowd, position: np.ndarray, velocity: np.ndarray, duration: float, step_s: float = 1e-3
) -> float:
    """Return the least m between discs and an anchor's centre, by its states [T, 2]."""
    samples = np.linspace(0.0, duration, len(position))
    motion = CubicHermiteSpline(samples, position.astype(float), velocity.astype(float))
    times = crowd.dense(duration, step_s)
    return crowd.gap(times, motion(times))
