"""Direct ways from a pose to a target: a turn, a straight line and, if need be, another turn.

They are the words of Dubins with a line in the middle ("On curves of minimal length with a
constraint on average curvature", American Journal of Mathematics 79, 1957), forwards or backwards.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.bodies.outline import Ground, touches
from anchorflow_trajectory.bodies.wheels import BACKWARDS, BEND, SLIDING, TURNING, Moves
from anchorflow_trajectory.compiled import compiled

LEG, LEG_TURN, SPOT_TURN = 0.06, 0.2, 0.1  # m and rad between two poses, and rad on the spot
MOST_TURN = 1.25 * np.pi  # of one turn
EXACT = 1e-6  # rad
LEAST_SLIDE = 0.2  # m of way that a rad of turning takes while sliding


class Target(NamedTuple):
    """Where ways end: a pose [3], whose heading may not count.

    gear: the last, or STANDING for any; braking: m that the last gear is driven for at least
    """

    pose: FloatArray
    heading: bool
    gear: int
    braking: float


@compiled
def direct_way(
    ground: Ground,
    corners: FloatArray,
    reach: float,
    moves: Moves,
    at: FloatArray,
    gear: int,
    target: Target,
    dearest: float,
    spans: FloatArray,
) -> tuple[NDArray[np.float64], float]:
    """The cheapest direct way [P, 4] from a pose to the target that touches nothing, and its cost.

    It is a turn, a straight line and, where the heading counts, another turn; of a robot that
    slides, a straight line.

    dearest: a cost from which no way is of use
    """
    if moves.slides:
        return _slide(ground, corners, reach, moves, at, gear, target, spans)
    return _turns_and_line(ground, corners, reach, moves, at, gear, target, dearest, spans)


@compiled
def _turns_and_line(
    ground: Ground,
    corners: FloatArray,
    reach: float,
    moves: Moves,
    at: FloatArray,
    gear: int,
    target: Target,
    dearest: float,
    spans: FloatArray,
) -> tuple[NDArray[np.float64], float]:
    """The cheapest of the turns, lines and turns to the target that touch nothing, and its cost."""
    best, best_cost = np.empty((0, 4)), dearest
    legs, found = np.empty((3, 2)), np.empty((0, 4))
    turns_last = target.heading and not moves.spot
    for way in range(2 if moves.reverse else 1):
        sign = moves.forward * (1.0 - 2.0 * way)
        price = BACKWARDS if way else 1.0
        for word in range(4 if turns_last else 2):
            first = 1.0 if word % 2 == 0 else -1.0
            last = first if word < 2 else -first
            if turns_last:
                fits = _two_turns(at, target.pose, sign, first, last, moves.radius, legs)
            else:
                fits = _one_turn(at, target.pose, sign, first, moves.radius, legs)
            if not fits or abs(legs[0, 1]) > MOST_TURN or abs(legs[2, 1]) > MOST_TURN:
                continue
            cost = price * (legs[0, 0] + legs[1, 0] + legs[2, 0])
            if int(sign) != gear:
                cost += moves.stop
            if cost >= best_cost:
                continue
            found = _drawn(at, sign, legs, target, moves.spot)
            cost += _cost_of_turn(found, moves)
            clear = True
            for k in range(len(found)):
                if touches(ground, corners, reach, found[k, :3], spans):
                    clear = False
                    break
            if clear:
                best, best_cost = found, cost
    return best, best_cost


@compiled
def _slide(
    ground: Ground,
    corners: FloatArray,
    reach: float,
    moves: Moves,
    at: FloatArray,
    gear: int,
    target: Target,
    spans: FloatArray,
) -> tuple[NDArray[np.float64], float]:
    """The straight way to the target on which the heading turns evenly, and its cost."""
    length, turn = np.hypot(target.pose[0] - at[0], target.pose[1] - at[1]), 0.0
    if target.heading:
        turn = (target.pose[2] - at[2] + np.pi) % (2.0 * np.pi) - np.pi
    new, cost = SLIDING, length + BEND * abs(turn)
    if length < LEAST_SLIDE * abs(turn):
        if length > EXACT:
            return np.empty((0, 4)), np.inf
        new, cost = TURNING, moves.spin * abs(turn)
    count = max(1, int(np.ceil(max(length / LEG, abs(turn) / SPOT_TURN))))
    way = np.empty((count, 4))
    for k in range(count):
        share = (k + 1.0) / count
        way[k, 0] = at[0] + share * (target.pose[0] - at[0])
        way[k, 1] = at[1] + share * (target.pose[1] - at[1])
        way[k, 2], way[k, 3] = at[2] + share * turn, new
        if touches(ground, corners, reach, way[k, :3], spans):
            return np.empty((0, 4)), np.inf
    return way, cost + (moves.stop if new != gear else 0.0)


@compiled
def _cost_of_turn(way: FloatArray, moves: Moves) -> float:
    """m, what a last turn on the spot costs of a way [P, 4]."""
    first = len(way)
    while first and way[first - 1, 3] == TURNING:
        first -= 1
    if first == len(way):
        return 0.0
    return moves.stop + moves.spin * abs(way[-1, 2] - way[max(first - 1, 0), 2])


@compiled
def _one_turn(
    at: FloatArray, goal: FloatArray, sign: float, side: float, radius: float, legs: FloatArray
) -> bool:
    """Whether a turn to one side and a line lead to a point; legs [3, 2]: m and signed rad each.

    sign: 1 forwards, -1 backwards; side: 1 for a circle to the left of the way
    """
    heading = at[2] if sign > 0.0 else at[2] + np.pi
    x, y = at[0] - side * radius * np.sin(heading), at[1] + side * radius * np.cos(heading)
    away = np.hypot(goal[0] - x, goal[1] - y)
    if away < radius:
        return False
    line = np.sqrt(away * away - radius * radius)
    toward = np.arctan2(goal[1] - y, goal[0] - x)
    end = toward + side * np.arctan2(radius, line)
    turn = side * ((side * (end - heading)) % (2.0 * np.pi))
    if abs(turn) > 2.0 * np.pi - EXACT:
        turn = 0.0
    legs[0, 0], legs[0, 1] = radius * abs(turn), turn
    legs[1, 0], legs[1, 1] = line, 0.0
    legs[2] = 0.0
    return True


@compiled
def _two_turns(
    at: FloatArray,
    goal: FloatArray,
    sign: float,
    first: float,
    last: float,
    radius: float,
    legs: FloatArray,
) -> bool:
    """Whether a turn, a line and a turn lead to a pose (Dubins, 1957); legs as in `_one_turn`."""
    back = 0.0 if sign > 0.0 else np.pi
    begin, end = at[2] + back, goal[2] + back
    x = goal[0] - last * radius * np.sin(end) - at[0] + first * radius * np.sin(begin)
    y = goal[1] + last * radius * np.cos(end) - at[1] - first * radius * np.cos(begin)
    away, along = np.hypot(x, y), np.arctan2(y, x)
    if first == last:
        line = away
    else:
        if away < 2.0 * radius:
            return False
        line = np.sqrt(away * away - 4.0 * radius * radius)
        along += first * np.arctan2(2.0 * radius, line)
    for leg, side, turn in ((0, first, along - begin), (2, last, end - along)):
        angle = (side * turn) % (2.0 * np.pi)
        if angle > 2.0 * np.pi - EXACT:
            angle = 0.0
        legs[leg, 0], legs[leg, 1] = radius * angle, side * angle
    legs[1, 0], legs[1, 1] = line, 0.0
    return True


@compiled
def _drawn(
    at: FloatArray, sign: float, legs: FloatArray, target: Target, spot: bool
) -> NDArray[np.float64]:
    """The poses [P, 4] along legs, with a last turn on the spot where the heading counts."""
    counts = np.zeros(4, np.int64)
    for leg in range(3):
        if legs[leg, 0] > 1e-6:
            counts[leg] = int(np.ceil(max(legs[leg, 0] / LEG, abs(legs[leg, 1]) / LEG_TURN)))
    x, y, heading = at[0], at[1], at[2]
    total = legs[0, 1] + legs[1, 1] + legs[2, 1]
    final = 0.0
    if target.heading and spot:
        final = (target.pose[2] - heading - total + np.pi) % (2.0 * np.pi) - np.pi
        counts[3] = int(np.ceil(abs(final) / SPOT_TURN)) if abs(final) > 1e-3 else 0
    way, row = np.empty((counts.sum(), 4)), 0
    for leg in range(3):
        for _ in range(counts[leg]):
            step, turn = sign * legs[leg, 0] / counts[leg], legs[leg, 1] / counts[leg]
            chord = step * (np.sin(turn / 2.0) / (turn / 2.0) if abs(turn) > 1e-9 else 1.0)
            x += chord * np.cos(heading + turn / 2.0)
            y += chord * np.sin(heading + turn / 2.0)
            heading += turn
            way[row] = x, y, heading, sign
            row += 1
    for _ in range(counts[3]):
        heading += final / counts[3]
        way[row] = x, y, heading, 0.0
        row += 1
    return way
