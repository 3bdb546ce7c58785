"""Noise levels of a diffusion, and the deterministic step from one to the next (DDIM).

Diffusion time counts the other way than flow time: t = 0 is nearly data, `levels` - 1 is noise.
Everything is plain arithmetic on its first arguments, so that it takes arrays and tensors alike.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Values = TypeVar("Values", bound=Any)

CLEAN = 1.0
"""The share of data, squared, that is left where there is no noise at all."""


@dataclass(frozen=True)
class NoiseLevels:
    """Scaled-linear variances: sqrt(beta_t) rises linearly (Rombach et al., 2022).

    levels: of the whole diffusion; first, last: beta of the first and the last of them
    """

    levels: int = 1000
    first: float = 1e-4
    last: float = 0.02

    def __post_init__(self) -> None:
        """Raises `ValueError` where there is no level, or the variances are none that rise."""
        if self.levels < 1:
            raise ValueError(f"levels: expected at least 1, got {self.levels}")
        if not 0.0 < self.first <= self.last < 1.0:
            raise ValueError(
                f"first, last: expected 0 < first <= last < 1, got {self.first}, {self.last}"
            )

    @cached_property
    def signal(self) -> NDArray[np.float64]:
        """[levels]: the product of 1 - beta up to each level, the share of data squared."""
        roots = np.linspace(math.sqrt(self.first), math.sqrt(self.last), self.levels)
        return np.cumprod(1.0 - roots**2, dtype=np.float64)

    def check_times(self, times: Sequence[int]) -> None:
        """Raises `ValueError` where times are not levels, or do not fall."""
        falls = all(t > after for t, after in pairwise(times))
        if not times or not falls or times[-1] < 0 or times[0] >= self.levels:
            most = self.levels - 1
            raise ValueError(f"expected falling times from {most} to 0, got {list(times)}")


def noised(x_0: Values, noise: Values, signal: Any) -> Values:
    """x_t of data and standard normal noise: sqrt(signal) x_0 + sqrt(1 - signal) noise."""
    return signal**0.5 * x_0 + (1.0 - signal) ** 0.5 * noise


def ddim_step(x_t: Values, x_0: Values, signal: float, *, following: float) -> Values:
    """x at the following level, of the x_0 that was found at this one.

    Equation 12 of Song et al. (Denoising Diffusion Implicit Models, 2021) with eta = 0; where
    `following` is CLEAN that is x_0 itself.
    """
    noise = (x_t - signal**0.5 * x_0) / (1.0 - signal) ** 0.5
    return noised(x_0, noise, following)
