"""How far motions go against their lanes, which the PDM score of NAVSIM v1.1 does not ask.

That of v2 does (driving direction compliance; Cao et al., 2025, arXiv:2506.04218), in steps: 1 up
to 2 m in a second, 0.5 up to 6 m, else 0. Who is on the wrong side learns nothing by steps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.pdm.tracker import Motion
from anchorflow_driving.pdm.traffic import Traffic

Array = NDArray[np.float64]

STRIDE = 2
"""Steps between two looks at the lanes."""
FREE_M, FADING_M = 2.0, 10.0
"""m against the lanes that cost nothing, and those in which compliance falls by e after them."""


def metres_against(motion: Motion, traffic: Traffic) -> Array:
    """[P] m that the middle of the box goes in lanes, all of which lead the other way."""
    middles = traffic.vehicle.middles(motion.poses[:, ::STRIDE])
    moved = np.linalg.norm(np.diff(middles[..., :2], axis=1), axis=-1)
    return (moved * traffic.road.against_lanes(middles[:, 1:])).sum(-1)


def direction_compliance(against: Array) -> Array:
    """In (0, 1], of m against the lanes."""
    return np.exp(-np.maximum(against - FREE_M, 0.0) / FADING_M)
