"""Speeds of boxes that are perceived without one, from where others are foretold to be."""

from __future__ import annotations

import numpy as np

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.compiled import compiled
from anchorflow_trajectory.guard.faults import Raster

LEAST, MOST, STRIDE = -5.0, 25.0, 0.5
"""m/s along a box's heading that are tried, and from one to the next."""
LOOK_S = 1.5
LIKELY = 0.9
"""Share of the best speed's support from which on another one counts too."""
SEEN = 0.1
"""Support below which nobody is foretold where a box goes at any speed."""
PLACES = (-0.3, 0.0, 0.3)
"""Lengths before the middle of a box at which occupancy is read."""


def boxes_of(agents: FloatArray, foretold: Raster | None) -> FloatArray:
    """Return boxes [K,8] as `Perceived` has them, of [K,5] x, y, heading, length, width.

    Each stands or drives along its heading, at any of the speeds that the occupancy supports: it
    moves at the middle one and grows by the others, so that it sweeps all places that they lead to.
    """
    low, high = np.zeros(len(agents)), np.zeros(len(agents))
    agents = np.ascontiguousarray(agents, np.float64)
    if foretold is not None and len(agents):
        _speeds(
            agents, np.ascontiguousarray(foretold.values, np.float32), foretold.frame, low, high
        )
    speed, growth = (low + high) / 2, (high - low) / 2
    heading = agents[:, 2]
    velocity = speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], -1)
    return np.concatenate([agents[:, :3], agents[:, 3:5] / 2, velocity, growth[:, None]], 1)


@compiled
def _speeds(agents, foretold, frame, low, high):
    """Lower `low` and raise `high`, which are 0, to the speeds of each box."""
    layers, rows, columns = foretold.shape
    tries = int((MOST - LEAST) / STRIDE + 0.5) + 1
    support = np.empty(tries)
    for k in range(len(agents)):
        cos, sin = np.cos(agents[k, 2]), np.sin(agents[k, 2])
        for index in range(tries):
            total, asked = 0.0, 0
            for layer in range(layers):
                later = frame[3] + layer * frame[4]
                if later > LOOK_S:
                    break
                for place in PLACES:
                    way = place * agents[k, 3] + (LEAST + index * STRIDE) * later
                    row = (frame[0] - agents[k, 0] - way * cos) / frame[2] - 0.5
                    column = (frame[1] - agents[k, 1] - way * sin) / frame[2] - 0.5
                    asked += 1
                    if row < 0 or column < 0 or row >= rows - 1 or column >= columns - 1:
                        continue
                    i, j = int(row), int(column)
                    y, x = row - i, column - j
                    upper = (1 - x) * foretold[layer, i, j] + x * foretold[layer, i, j + 1]
                    lower = (1 - x) * foretold[layer, i + 1, j] + x * foretold[layer, i + 1, j + 1]
                    total += (1 - y) * upper + y * lower
            support[index] = total / max(asked, 1)
        most = support.max()
        if most >= SEEN:
            for index in range(tries):
                if support[index] >= LIKELY * most:
                    low[k] = min(low[k], LEAST + index * STRIDE)
                    high[k] = max(high[k], LEAST + index * STRIDE)
