"""What a request asks of the finish, and the finished anchors."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import BoolArray, FloatArray


class Refinement(Protocol):
    """The options of a finish; the contract's `RefineSpec` is one."""

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
        """Move anchors that are too close to obstacles by a control barrier."""
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
    routes: [N], equal for anchors that pass everything, still or moving, on the same sides; counted
        from 0 in the order of their best scores
    """

    positions: FloatArray
    velocities: FloatArray
    accelerations: FloatArray
    duration: FloatArray
    scores: FloatArray
    clearance: FloatArray
    safe: BoolArray
    routes: NDArray[np.int64]


def numbered(classes: Sequence[Hashable], scores: FloatArray) -> NDArray[np.int64]:
    """Return the numbers [N] of classes, counted in the order of their best scores."""
    numbers: dict[Hashable, int] = {}
    for n in np.argsort(-scores, kind="stable").tolist():
        numbers.setdefault(classes[n], len(numbers))
    return np.array([numbers[each] for each in classes], np.int64)
