"""Roll out and cost many motions at once.

J = sum_t dt (collision + nearness + distance + arrival + effort + smoothness + reversing
              + soft costs) + terminal * metres left from the end of the motion
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from anchorflow_control.config import MppiConfig
from anchorflow_control.cost_to_go import WayLeft, metres_left
from anchorflow_control.dynamics import OMNI, Limits, drive
from anchorflow_control.surroundings import (
    Grid,
    Surroundings,
    clear_of_movers,
    clear_of_obstacles,
    value_at,
)
from anchorflow_trajectory.compiled import compiled

Floats = NDArray[np.float32]

NONE, HALF, ONE, DEEPER = map(np.float32, (0.0, 0.5, 1.0, 4.0))
STOPS = 2  # places at which a motion is checked while the robot would brake after its end
REST = np.float32(0.1)  # m/s, added to the speed near obstacles


class Weights(NamedTuple):
    """The costs of `MppiConfig` in float32."""

    margin: np.float32
    comfort: np.float32
    collision: np.float32
    nearness: np.float32
    distance: np.float32
    arrival: np.float32
    effort: np.float32
    smoothness: np.float32
    reversing: np.float32
    terminal: np.float32

    @staticmethod
    def of(config: MppiConfig) -> Weights:
        return Weights(*(np.float32(getattr(config, name)) for name in Weights._fields))


class Task(NamedTuple):
    """The inputs that the motions of one tick share.

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


@dataclass(frozen=True, eq=False)
class Motions:
    """controls: [K,T,2]; costs: [K]; states: [K,T,5]; rooms: [K,T] m beside the body.

    Rooms are exact where they cost something.
    """

    controls: Floats
    costs: Floats
    states: Floats
    rooms: Floats

    @staticmethod
    def under(task: Task, controls: Floats) -> Motions:
        """Roll out controls [K,T,2].

        Each loop takes arrays, not tuples of them, whose references numba would count.
        """
        count, steps, _ = controls.shape
        states, costs = np.empty((count, steps, 5), np.float32), np.empty(count, np.float32)
        drive(task.limits, task.start, task.dt, controls, states)
        rooms = clearances(task, states, task.weights.margin + task.weights.comfort)
        distance, surcharge, _ = task.around
        metres_left(*task.left, distance, task.goal, states, costs)
        charge(
            task.limits, task.weights, task.dt, task.goal, surcharge, controls, states, rooms, costs
        )
        stops = np.empty((count, STOPS, 5), np.float32)
        stopping_places(task.limits, states, stops)
        charge_stops(
            task.weights, task.limits, states, clearances(task, stops, moving=False), costs
        )
        return Motions(controls, costs, states, rooms)

    def replaced(
        self, these: NDArray[np.bool_], others: Motions, indices: NDArray[np.intp]
    ) -> Motions:
        """Return the motions, with these [K] replaced by the others of indices [K]."""
        fields = {}
        for name, own in vars(self).items():
            other = getattr(others, name)[indices]
            fields[name] = np.where(these.reshape(-1, *[1] * (own.ndim - 1)), other, own)
        return Motions(**fields)

    def steps_clear(self, k: int, floor: float) -> int:
        """Return the steps that motion k stays at least `floor` m from everything."""
        low = self.rooms[k] < floor
        return int(low.argmax()) if low.any() else len(low)


def clearances(
    task: Task, states: Floats, enough: float = np.inf, *, moving: bool = True
) -> Floats:
    """Return m [K,T] beside the body in states [K,T,5], exact below `enough`.

    moving: count moving discs too, at the ends of T steps
    """
    rooms = np.empty(states.shape[:2], np.float32)
    clear_of_obstacles(task.around.distance, task.discs, np.float32(enough), states, rooms)
    if moving and task.around.movers.counts.any():
        clear_of_movers(*task.around.movers, task.discs, states, rooms)
    return rooms


@compiled
def charge(
    limits: Limits,
    weights: Weights,
    dt: np.float32,
    goal: Floats,
    surcharge: Grid,
    controls: Floats,
    states: Floats,
    rooms: Floats,
    costs: Floats,
) -> None:
    """Turn the metres left [K] into the costs of motions."""
    scale_first = ONE / limits.a_max
    scale_second = ONE / (limits.a_max if limits.kind == OMNI else limits.alpha_max)
    is_dear = surcharge.values.size > 0
    for k in range(len(controls)):
        cost, first, second = (
            NONE,
            scale_first * controls[k, 0, 0],
            scale_second * controls[k, 0, 1],
        )
        for t in range(controls.shape[1]):
            before, before_second = first, second
            first, second = scale_first * controls[k, t, 0], scale_second * controls[k, t, 1]
            jerk, jolt = first - before, second - before_second
            x, y, v, w = states[k, t, 0], states[k, t, 1], states[k, t, 3], states[k, t, 4]
            speed = np.sqrt(v * v + w * w) if limits.kind == OMNI else abs(v)
            cost += _place_cost(weights, rooms[k, t] - weights.margin, speed)
            away_x, away_y = x - goal[0], y - goal[1]
            away = np.sqrt(away_x * away_x + away_y * away_y)
            cost += weights.distance * away + weights.arrival * min(away, ONE)
            turn = NONE if limits.kind == OMNI else w / limits.omega_max
            cost += weights.effort * (first * first + second * second + turn * turn)
            cost += weights.smoothness * (jerk * jerk + jolt * jolt)
            if limits.kind != OMNI:
                cost += weights.reversing * max(-v, NONE)
            if is_dear:
                cost += weights.terminal * speed * value_at(surcharge, x, y)
        costs[k] = dt * cost + weights.terminal * costs[k]


@compiled
def stopping_places(limits: Limits, states: Floats, stops: Floats) -> None:
    """Write states [K,STOPS,5] straight on from the ends of motions [K,T,5], up to standstill."""
    end = states.shape[1] - 1
    for k in range(len(states)):
        heading, v, w = states[k, end, 2], states[k, end, 3], states[k, end, 4]
        speed = np.sqrt(v * v + w * w) if limits.kind == OMNI else v
        by_x, by_y = speed * np.cos(heading), speed * np.sin(heading)
        if limits.kind == OMNI:
            by_x, by_y = v, w
        # Half the speed times the time to stop.
        lasting = HALF * abs(speed) / limits.a_max
        for i in range(STOPS):
            share = lasting * np.float32((i + 1) / STOPS)
            stops[k, i, :] = states[k, end, :]
            stops[k, i, 0] += share * by_x
            stops[k, i, 1] += share * by_y


@compiled
def charge_stops(
    weights: Weights, limits: Limits, states: Floats, rooms: Floats, costs: Floats
) -> None:
    """Add to costs [K] the collisions of robots that brake at the ends of motions [K,T,5].

    rooms: [K,STOPS] m at the stopping places
    """
    end = states.shape[1] - 1
    for k in range(len(states)):
        v, w = states[k, end, 3], states[k, end, 4]
        speed = np.sqrt(v * v + w * w) if limits.kind == OMNI else abs(v)
        for i in range(STOPS):
            spare = rooms[k, i] - weights.margin
            if spare < NONE:
                lasting = speed / limits.a_max / np.float32(STOPS)
                costs[k] += lasting * weights.collision * (ONE - DEEPER * spare)


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
