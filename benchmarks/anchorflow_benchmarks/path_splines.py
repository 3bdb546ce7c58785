"""Splines along paths that somebody else found, each with a duration of its own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory.cost import MotionLimits
from anchorflow_trajectory.route_splines import LEAST_WAY
from anchorflow_trajectory.routes import polyline_length
from anchorflow_trajectory.spline import Ends, SplineBasis, Splines
from anchorflow_trajectory.time_law import nominal_duration, ramp_share, time_along


def driven_along(
    paths: Sequence[NDArray[np.floating]], basis: SplineBasis, ends: Ends, *, limits: MotionLimits
) -> Splines:
    """A spline along each polyline [P, 2], as quick as the limits allow, or within the horizon."""
    lengths = [max(polyline_length(path), LEAST_WAY) for path in paths]
    duration = np.array([limits.horizon_s or nominal_duration(way, limits) for way in lengths])
    timed = [
        time_along(path, basis.num_samples, ramp=ramp_share(float(lasts), way, limits))
        for path, lasts, way in zip(paths, duration, lengths, strict=True)
    ]
    return basis.fit_positions(np.stack(timed), ends, duration)
