"""Roll out and cost many motions at once.

J = sum_t dt (collision + nearness + distance + effort + smoothness + reversing + soft costs)
    + terminal * metres left from the end of the motion
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from anchorflow_control.config import MppiConfig
from anchorflow_control.cost_to_go import WayLeft, metres_left
from anchorflow_control.dynamics import OMNI, Limits, step
from anchorflow_control.surroundings import Surroundings, body_clearance, value_at
from anchorflow_trajectory.compiled import compiled

Floats = NDArray[np.float32]

NONE, ONE, REST, DEEPER = map(np.float32, (0.0, 1.0, 0.3, 4.0))


class Weights(NamedTuple):
    """The costs of `MppiConfig` in float32."""

    margin: np.float32
    comfort: np.float32
    collision: np.float32
    nearness: np.float32
    distance: np.float32
    effort: np.float32
    smoothness: np.float32
    reversing: np.float32
    terminal: np.float32

    @staticmethod
    def of(config: MppiConfig) -> Weights:
        return Weights(*(np.float32(getattr(config, name)) for name in Weights._fields))


class Task(NamedTuple):
    """What the motions of one tick have in common.

    start: [5] state, at the origin; discs: [J,3] of the body; dt: s of a step; goal: [2] m
    """

    limits: Limits
    start: Floats
    discs: Floats
    around: Surroundings
    weights: Weights
    dt: np.float32
    goal: Floats
    left: WayLeft


@compiled
def roll_out(task: Task, controls: Floats, costs: Floats, states: Floats, rooms: Floats) -> None:
    """Write costs [K], states [K,T,5] and clearances [K,T] in m under controls [K,T,2].

    Clearances are exact below margin + comfort.
    """
    limits, start, weights = task.limits, task.start, task.weights
    enough = weights.margin + weights.comfort
    scale_first = ONE / limits.a_max
    scale_second = ONE / (limits.a_max if limits.kind == OMNI else limits.alpha_max)
    for k in range(len(controls)):
        state = (start[0], start[1], start[2], start[3], start[4])
        cost, first, second = NONE, controls[k, 0, 0], controls[k, 0, 1]
        for t in range(controls.shape[1]):
            before, before_second = first, second
            first, second = controls[k, t, 0], controls[k, t, 1]
            state = step(limits, state, first, second, task.dt)
            x, y, heading, v, w = state
            speed = np.sqrt(v * v + w * w) if limits.kind == OMNI else abs(v)
            room = body_clearance(task.around, task.discs, t, (x, y, heading), enough)
            cost += _place_cost(weights, room - weights.margin, speed)
            away_x, away_y = x - task.goal[0], y - task.goal[1]
            cost += weights.distance * np.sqrt(away_x * away_x + away_y * away_y)
            push, twist = first * scale_first, second * scale_second
            jerk, jolt = (first - before) * scale_first, (second - before_second) * scale_second
            cost += weights.effort * (push * push + twist * twist)
            cost += weights.smoothness * (jerk * jerk + jolt * jolt)
            if limits.kind != OMNI and v < NONE:
                cost -= weights.reversing * v
            if task.around.surcharge.values.size:
                soft = value_at(task.around.surcharge, x, y)
                cost += weights.terminal * speed * soft
            rooms[k, t] = room
            states[k, t, 0], states[k, t, 1], states[k, t, 2] = x, y, heading
            states[k, t, 3], states[k, t, 4] = v, w
        left = metres_left(task.left, task.around.distance, state[0], state[1], task.goal)
        costs[k] = task.dt * cost + weights.terminal * left


@compiled
def _place_cost(weights: Weights, spare: np.float32, speed: np.float32) -> np.float32:
    """Return the cost of a second at m beyond the margin, and a speed.

    Deeper inside an obstacle costs more, so that a squeezed robot finds its way out.
    """
    cost = NONE
    if spare < NONE:
        cost = weights.collision * (ONE - DEEPER * spare)
        spare = NONE
    if spare < weights.comfort:
        lack = ONE - spare / weights.comfort
        cost += weights.nearness * lack * lack * (REST + speed)
    return cost
