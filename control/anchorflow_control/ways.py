"""Which motions pass the obstacles on the same side, so that one may replace the other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_control.surroundings import Grid, Surroundings, value_at
from anchorflow_trajectory.compiled import compiled

Floats = NDArray[np.float32]

NONE = np.float32(0.0)
APART = np.float32(0.7)  # m between the end of a motion and the path of another
SHORTEST = np.float32(0.02)  # m, by which the line between two motions is followed at least


@compiled
def is_same_way(
    distance: Grid,
    places: Floats,
    radii: Floats,
    counts: NDArray[np.int64],
    states: Floats,
    others: Floats,
) -> bool:
    """Return whether the straight lines between two motions [T,5] meet no obstacle.

    The places of one moment are joined: a motion before and one behind a mover differ too. So do
    motions that end APART m beside each other, as obstacles may follow.

    distance: m to obstacles; places, radii, counts: of `Movers`
    """
    if min(_beside(states, others), _beside(others, states)) > APART:
        return False
    for t in range(len(states)):
        x, y = states[t, 0], states[t, 1]
        by_x, by_y = others[t, 0] - x, others[t, 1] - y
        length = np.sqrt(by_x * by_x + by_y * by_y)
        at = NONE
        while at < length:
            here_x, here_y = x + at / length * by_x, y + at / length * by_y
            room = value_at(distance, here_x, here_y)
            for m in range(counts[t]):
                across, along = here_x - places[t, m, 0], here_y - places[t, m, 1]
                room = min(room, np.sqrt(across * across + along * along) - radii[t, m])
            if room <= NONE:
                return False
            at += max(room, SHORTEST)
    return True


@compiled
def _beside(states: Floats, others: Floats) -> np.float32:
    """Return m from the end of a motion [T,5] to the path of another."""
    end, least = len(states) - 1, np.float32(np.inf)
    for t in range(len(others)):
        across, along = others[t, 0] - states[end, 0], others[t, 1] - states[end, 1]
        least = min(least, np.sqrt(across * across + along * along))
    return least


@compiled
def ways_of(
    around: Surroundings, states: Floats, order: NDArray[np.int64], most: int, of: NDArray[np.int64]
) -> int:
    """Write the way [K] of motions [K,T,5], and return how many there are.

    Ways are numbered from 0 on, that of the first motion first, then as `order` [K] meets them;
    motions on none of the first `most` ways have -1.
    """
    distance, movers = around.distance, around.movers
    places, radii, counts = movers.places, movers.radii, movers.counts
    first = np.zeros(most, np.int64)
    of[:] = -1
    of[0], count = 0, 1
    for k in order:
        if k == 0:
            continue
        for way in range(count):
            if is_same_way(distance, places, radii, counts, states[first[way]], states[k]):
                of[k] = way
                break
        if of[k] < 0 and count < most:
            first[count], of[k] = k, count
            count += 1
    return count
