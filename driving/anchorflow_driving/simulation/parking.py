"""Cars that stand in the parking lanes; SUMO knows nothing of them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.simulation.road_net import RoadNet

Array = NDArray[np.float64]

SPACING, MARGIN = 6.5, 6.0  # m


def parked_cars(
    net: RoadNet, rng: np.random.Generator
) -> Iterator[tuple[tuple[float, float], Array]]:
    """Length and width, and state [5], of each."""
    occupied = rng.uniform(0.1, 0.9)
    for band in net.parking:
        right, left = band[: len(band) // 2], band[len(band) // 2 :][::-1]
        middle = (right + left) / 2
        length = np.concatenate([[0.0], np.linalg.norm(np.diff(middle, axis=0), axis=1).cumsum()])
        for place in np.arange(MARGIN, length[-1] - MARGIN, SPACING):
            if rng.random() > occupied:
                continue
            x, y = (np.interp(place, length, axis) for axis in middle.T)
            ahead = [np.interp(place + 1.0, length, axis) for axis in middle.T]
            heading = np.arctan2(ahead[1] - y, ahead[0] - x) + rng.normal(0.0, 0.03)
            size = (float(rng.uniform(3.7, 5.0)), float(rng.uniform(1.65, 1.95)))
            yield size, np.array([x, y, heading, 0.0, 0.0])
