"""The drivers that are compared among people: anchors, MPPI and a straight line.

A driver sees where people are and how fast, and returns the robot's next state.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from anchorflow_benchmarks.crowds.worlds import CONTACT, RADIUS, TICK_S, Array, Grid, World
from anchorflow_client.contract import AnchorRequest, resolve_for_card
from anchorflow_service.engine import Engine

V_MAX, A_MAX = 2.0, 2.0  # m/s, m/s^2, of the robot
CRUISE = 1.5  # m/s, if no time of arrival is set
PASSING = 1.3  # m/s at the goal of a request that is short of the world's
MIN_HORIZON_S = 1.0
EMPTY_MAP_CELLS = 32  # of a side; a map without obstacles needs no more


class Driver(Protocol):
    """Drives one run after another; `name` is that in the tables."""

    @property
    def name(self) -> str: ...

    def begin(self, seed: int) -> None:
        """Begin a run; equal seeds draw equal noise."""
        ...

    def step(self, world: World, state: Array) -> Array | None:
        """Return the state [6] TICK_S after a state of position, velocity, acceleration.

        None to brake.
        """
        ...


@dataclass(frozen=True)
class StraightDriver:
    """Drives straight to the goal in the time that is left, without yielding."""

    name: str = "straight line"
    response_s: float = 0.3
    """Time constant of its speed."""

    def begin(self, seed: int) -> None:
        pass

    def step(self, world: World, state: Array) -> Array:
        way = world.goal - state[:2]
        left = world.left_s or np.hypot(*way) / CRUISE
        wanted = at_most(way / max(left - 0.4, 0.4), V_MAX)
        return moved(state, at_most((wanted - state[2:4]) / self.response_s, A_MAX))


class MppiDriver:
    """MPPI (Williams et al., 2017) in plain numpy, with people at constant velocity.

    Its cost holds the robot to an even pace along the way to the goal, and away from people and
    walls; each sample holds an acceleration for five ticks.
    """

    samples, steps, held = 512, 50, 5
    sigma, temperature = 1.2, 0.5  # m/s^2 of the disturbances; lambda
    person_range, wall_range = 0.15, 0.1  # m over which nearness falls by e
    name = "MPPI with velocities"

    def begin(self, seed: int) -> None:
        self._plan = np.zeros((self.steps, 2))
        self._rng = np.random.default_rng(seed)

    def step(self, world: World, state: Array) -> Array:
        self._plan = np.concatenate([self._plan[1:], self._plan[-1:]])
        blocks = (self.samples, self.steps // self.held, 2)
        noise = self._rng.normal(0.0, self.sigma, blocks).repeat(self.held, axis=1)
        noise[0] = 0.0
        plans = at_most(self._plan + noise, A_MAX)
        cost = self._cost(world, state, plans)
        weights = np.exp((cost.min() - cost) / self.temperature)
        self._plan = np.tensordot(weights / weights.sum(), plans, 1)
        return moved(state, self._plan[0])

    def _cost(self, world: World, state: Array, plans: Array) -> Array:
        """Return J [K] of accelerations [K, T, 2]."""
        dt = TICK_S
        velocities = state[2:4] + dt * plans.cumsum(1)
        positions = state[:2] + dt * (velocities - 0.5 * dt * plans).cumsum(1)
        overspeed = np.maximum(np.linalg.norm(velocities, axis=-1) - V_MAX, 0.0)
        running = 30.0 * overspeed + 0.02 * (plans**2).sum(-1)

        time = dt * np.arange(1, self.steps + 1)
        here, to_go = float(world.way_to_goal(state[:2])), world.way_to_goal(positions)
        pace = CRUISE if world.left_s is None else here / max(world.left_s - 0.8, 0.8)
        running += 2.0 * np.abs(to_go - np.maximum(here - min(pace, V_MAX) * time, 0.0))
        due = self.steps if world.left_s is None else round(world.left_s / dt)
        final = 4.0 * to_go[:, -1] + 12.0 * to_go[:, min(due, self.steps) - 1]

        for person in np.flatnonzero(world.present):
            ahead = world.positions[person] + time[:, None] * world.velocities[person]
            gap = np.linalg.norm(positions - ahead, axis=-1) - CONTACT
            running += _nearness(gap, margin=0.05, reach=self.person_range)
        gap = world.wall_distance(positions) - RADIUS
        running += _nearness(gap, margin=0.03, reach=self.wall_range)
        return dt * running.sum(1) + final


def _nearness(gap: Array, *, margin: float, reach: float) -> Array:
    return 1000.0 * (gap < margin) + 8.0 * np.exp(-np.maximum(gap, 0.0) / reach)


class AnchorDriver:
    """Follows the safe anchor with the best score, and brakes without one.

    People are `obstacles` of the request with their velocities, or, if `painted`, occupied discs
    of the map: all that a planner for standing obstacles can take.
    """

    def __init__(
        self, name: str, engine: Engine, *, num: int = 64, painted: bool = False, pace: bool = False
    ) -> None:
        """num: anchors a request; pace: request the time that is left as horizon_s."""
        self.name = name
        self._engine, self._num, self._painted, self._pace = engine, num, painted, pace

    def begin(self, seed: int) -> None:
        self._seeds = np.random.default_rng(seed)

    def step(self, world: World, state: Array) -> Array | None:
        request = self.request_of(world, state, seed=int(self._seeds.integers(2**31)))
        answer = self._engine.plan(resolve_for_card(request, self._engine.card))
        safe = answer.safe
        if not safe.any():
            return None
        best = int(np.where(safe, answer.arrays["scores"], -np.inf).argmax())
        dt = float(np.broadcast_to(answer.dt, len(safe))[best])
        tracks = (answer.trajectories, answer.velocities, answer.accelerations)
        samples = np.concatenate([track[best, :, :2] for track in tracks], -1).astype(np.float64)
        times = dt * np.arange(len(samples))
        return np.array([np.interp(TICK_S, times, column) for column in samples.T])

    def request_of(self, world: World, state: Array, *, seed: int) -> AnchorRequest:
        """Build the request of a moment, in the world's frame."""
        position, people = state[:2], world.present
        grid = world.map_around(position)
        way = world.goal - position
        share = min(1.0, world.reach / max(float(np.hypot(*way)), 1e-9))
        goal = position + share * way
        speed = np.zeros(2) if share == 1.0 else PASSING * way / np.hypot(*way)
        further: dict[str, Any] = {}
        if self._pace and world.left_s is not None:
            further["horizon_s"] = max(share * world.left_s, MIN_HORIZON_S)
        if self._painted:
            grid = with_people(grid, world.positions[people], ends=(position, goal))
        else:
            further["obstacles"] = {
                "position": world.positions[people],
                "velocity": world.velocities[people],
                "radius": np.full(people.sum(), RADIUS),
            }
        occupied, resolution = grid.occupied, grid.resolution
        if not occupied.any():
            resolution *= len(occupied) / EMPTY_MAP_CELLS
            occupied = np.zeros((EMPTY_MAP_CELLS, EMPTY_MAP_CELLS), bool)
        return AnchorRequest.build(
            cost_map={
                "data": occupied[None].astype(np.float32),
                "resolution": resolution,
                "origin": grid.origin,
            },
            x_curr=state,
            x_goal=np.concatenate([goal, speed]),
            num_samples=self._num,
            robot_radius=RADIUS,
            v_max=V_MAX,
            a_max=A_MAX,
            seed=seed,
            **further,
        )


def with_people(grid: Grid, people: Array, *, ends: tuple[Array, Array]) -> Grid:
    """Paint people as discs; those who touch the robot, and cells of start and goal, stay free."""
    centres, occupied = grid.centres, grid.occupied.copy()
    start, goal = ends
    for person in people:
        if np.hypot(*(person - start)) > CONTACT + 0.02:
            occupied |= np.linalg.norm(centres - person, axis=-1) < RADIUS
    free = np.linalg.norm(centres - start, axis=-1) < grid.resolution
    free |= np.linalg.norm(centres - goal, axis=-1) < RADIUS + grid.resolution
    return Grid(occupied & (grid.occupied | ~free), grid.resolution, grid.origin)


def moved(state: Array, acceleration: Array) -> Array:
    """Return the state [6] after TICK_S of an acceleration [2]."""
    position, velocity = state[:2], state[2:4]
    position = position + TICK_S * velocity + 0.5 * TICK_S**2 * acceleration
    return np.concatenate([position, velocity + TICK_S * acceleration, acceleration])


def braked(state: Array) -> Array:
    """Return the state [6] after TICK_S of the hardest braking."""
    return moved(state, at_most(-state[2:4] / TICK_S, A_MAX))


def at_most(vectors: Array, size: float) -> Array:
    """Shorten vectors [..., 2] to a size."""
    norm = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors * (size / np.maximum(norm, size))
