"""CFM-MPPI as a rival: a flow over velocities that is guided past people, and MPPI about its best.

The method is that of Mizuta and Leung, "Unified Generation-Refinement Planning: Bridging Guided
Flow Matching and Sampling-Based MPC for Social Navigation" (ICRA 2026), with their schedule,
strengths and costs. Its field is trained here, in a minute and before the first run, on people of
the RVO2 library in open ground; it is a perceptron where theirs is a transformer. A plan covers the
whole run, and what was driven already is held fixed in it.
"""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np
import pyrvo
import torch
from torch import Tensor, nn

from anchorflow_benchmarks import BenchmarkError
from anchorflow_benchmarks.crowds.drivers import A_MAX, at_most, moved
from anchorflow_benchmarks.crowds.worlds import CONTACT, RADIUS, TICK_S, Array, World

TICKS = 80
"""Of a plan: 8 s."""
SCALE = 2.0  # m/s of a velocity that the field has as 1
SAMPLES = 200
FROM_NOISE = (0.0, 0.5, 0.8, 0.85, 0.9, 0.92, 0.94, 0.96, 0.98, 1.0)
FROM_LAST = (0.8, 0.85, 0.9, 0.92, 0.94, 0.96, 0.98, 1.0)
"""Flow times of the first plan, and of a plan that begins at the last one with noise."""
STRENGTHS = np.repeat([0.1, 0.3, 0.5, 0.7, 0.9], SAMPLES // 5)[:, None, None]
TO_GOAL = 0.1
"""Strengths of the guidance past people, of a fifth of the samples each, and to the goal."""
WORST = 5  # people at a tick who count
SOONER = 1.01  # factor of the guidance by tick before the end
GAIN = 3.0  # 1/s, from a velocity that is off to an acceleration
SIGMA, LAMBDA = 0.4, 0.1  # m/s^2 and temperature of MPPI
STEEPNESS = 20.0  # 1/m of its cost of nearness

CROWDS, WALKERS, WALK_S = 60, 20, 16.0
HALF, SPEEDS = 7.0, (0.4, 2.0)  # m of the ground, m/s
STEPS, BATCH, RATE, WIDTH = 3000, 256, 1e-3, 256


class CfmMppiDriver:
    """Drives by CFM-MPPI in open ground, where the run has an end."""

    name = "CFM-MPPI"

    def begin(self, seed: int) -> None:
        self._field = trained_field()
        self._rng = np.random.default_rng(seed)
        self._driven: list[Array] = []
        self._plan: Array | None = None

    def step(self, world: World, state: Array) -> Array:
        if world.left_s is None:
            raise BenchmarkError("CFM-MPPI is for recorded people: rooms have walls")
        if world.ticks > TICKS:
            expected = f"windows of at most {TICKS * TICK_S:g} s, got {world.ticks * TICK_S:g}"
            raise BenchmarkError(f"CFM-MPPI: expected {expected}")
        if not self._driven:
            self._start = state[:2].copy()
        people = world.present
        position, velocity = world.positions[people], world.velocities[people]
        sampled = self._sampled(world.goal, position, velocity)
        now = len(self._driven)
        best, acceleration = self._refined(state, sampled[:, now:], world.goal, position, velocity)
        self._plan, after = sampled[best], moved(state, acceleration)
        self._driven.append((after[:2] - state[:2]) / TICK_S)
        return after

    def _sampled(self, goal: Array, people: Array, walking: Array) -> Array:
        """Return velocities [SAMPLES, TICKS, 2] m/s of the guided flow."""
        rng, now = self._rng, len(self._driven)
        times, x = FROM_NOISE, rng.normal(size=(SAMPLES, TICKS, 2))
        if self._plan is not None:
            times = FROM_LAST
            x = times[0] * self._plan / SCALE + (1 - times[0]) * x
        ahead = TICK_S * (np.arange(TICKS) - now + 1)[:, None]
        places = people[:, None] + ahead * walking[:, None]
        sooner = SOONER ** np.arange(TICKS)[::-1, None]
        for t, after in pairwise(times):
            self._hold(x)
            flow = self._field.at(x, t, goal - self._start)
            end = x + (1 - t) * flow
            self._hold(end)
            safer = safety_slope(SCALE * end, self._start, places, walking)
            nearer = self._goal_slope(SCALE * end, goal)
            safer[:, :now] = nearer[:, :now] = 0.0
            size = np.linalg.norm(flow)
            guided = flow + STRENGTHS * sooner * safer * (size / (np.linalg.norm(safer) + 1e-8))
            guided += TO_GOAL * nearer * (size / (np.linalg.norm(nearer) + 1e-8))
            x = x + (after - t) * guided
        self._hold(x)
        return SCALE * x

    def _hold(self, x: Array) -> None:
        """Put what was driven into plans in units of the field."""
        if self._driven:
            x[:, : len(self._driven)] = np.array(self._driven) / SCALE

    def _goal_slope(self, velocities: Array, goal: Array) -> Array:
        """Return the slope [N, T, 2] of minus the distance to the goal at the end."""
        short = goal - self._start - TICK_S * velocities.sum(1)
        short /= np.linalg.norm(short, axis=-1, keepdims=True) + 1e-9
        return np.repeat(short[:, None], TICKS, 1)

    def _refined(
        self, state: Array, velocities: Array, goal: Array, people: Array, walking: Array
    ) -> tuple[int, Array]:
        """Return the best of velocities [N, T, 2], and MPPI's first acceleration about it."""
        plans = followed(state, velocities)
        best = int(self._cost(state, plans, goal, people, walking).argmin())
        noise = self._rng.normal(0.0, SIGMA, plans.shape)
        tried = np.clip(plans[best] + noise, -A_MAX, A_MAX)
        cost = self._cost(state, tried, goal, people, walking)
        weights = np.exp((cost.min() - cost) / LAMBDA)
        return best, at_most(np.tensordot(weights / weights.sum(), tried[:, 0], 1), A_MAX)

    @staticmethod
    def _cost(state: Array, plans: Array, goal: Array, people: Array, walking: Array) -> Array:
        """Return the cost [N] of accelerations [N, T, 2]."""
        velocities = state[2:4] + TICK_S * plans.cumsum(1)
        positions = state[:2] + TICK_S * velocities.cumsum(1)
        to_goal = np.linalg.norm(positions - goal, axis=-1)
        change = np.linalg.norm(np.diff(plans, axis=1, prepend=plans[:, :1]), axis=-1)
        cost = 0.1 * (to_goal.sum(1) + change.sum(1) + to_goal[:, -1])
        ticks = np.arange(plans.shape[1])
        sooner = 100.0 * (1.0 + 0.99**ticks)
        for place, velocity in zip(people, walking, strict=True):
            there = place + TICK_S * (ticks[:, None] + 1) * velocity
            gap = np.linalg.norm(positions - there, axis=-1) - CONTACT
            cost += (sooner * np.minimum(np.exp(-STEEPNESS * gap), 1.0)).sum(1)
        return cost


def safety_slope(velocities: Array, start: Array, places: Array, walking: Array) -> Array:
    """Return the slope [N, T, 2] of the reward by which barriers to people are kept.

    With d the way from a person to the robot, and w that person's velocity, a tick is rewarded by
    min(0, 2 d (u - w) + |d|^2 - r^2), for the WORST people of a tick, the worst five times.

    velocities: [N, T, 2] m/s; start: [2] m
    places: [M, T, 2] m of people; walking: [M, 2] m/s
    """
    positions = start + TICK_S * velocities.cumsum(1)
    apart = positions[:, None] - places  # [N, M, T, 2]
    closing = velocities[:, None] - walking[:, None]
    kept = 2 * (apart * closing).sum(-1) + (apart**2).sum(-1) - CONTACT**2
    rank = kept.argsort(1).argsort(1)
    count = min(WORST, len(places))
    weight = np.where(kept < 0, np.maximum(count - rank, 0), 0)[..., None]
    by_speed = (2 * weight * apart).sum(1)
    by_place = (2 * weight * (closing + apart)).sum(1)
    return by_speed + TICK_S * by_place[:, ::-1].cumsum(1)[:, ::-1]


def followed(state: Array, velocities: Array) -> Array:
    """Return accelerations [N, T, 2] that a robot of A_MAX follows velocities [N, T, 2] by."""
    speed = np.broadcast_to(state[2:4], velocities[:, 0].shape)
    plans = np.empty_like(velocities)
    after = np.concatenate([velocities[:, 1:], velocities[:, -1:]], 1)
    for tick in range(velocities.shape[1]):
        wanted = velocities[:, tick]
        plan = (after[:, tick] - wanted) / TICK_S + GAIN * (wanted - speed)
        plans[:, tick] = np.clip(plan, -A_MAX, A_MAX)
        speed = speed + TICK_S * plans[:, tick]
    return plans


class VelocityField(nn.Module):
    """A perceptron from velocities, flow time and goal to their flow; all in units of SCALE."""

    def __init__(self) -> None:
        super().__init__()
        size = 2 * TICKS
        layers = (nn.Linear(size + 3, WIDTH), nn.SiLU(), nn.Linear(WIDTH, WIDTH), nn.SiLU())
        self.layers = nn.Sequential(*layers, nn.Linear(WIDTH, size))

    def forward(self, x: Tensor, t: Tensor, goal: Tensor) -> Tensor:
        """Return [N, 2 TICKS] of velocities [N, 2 TICKS], times [N, 1] and goals [N, 2]."""
        return self.layers(torch.cat([x, t, goal], -1))

    def at(self, x: Array, t: float, goal: Array) -> Array:
        """Return the flow [N, TICKS, 2] of velocities at a time, to a goal [2] m from the start."""
        goals = np.tile(goal / (SCALE * TICKS * TICK_S), (len(x), 1))
        given = (x.reshape(len(x), -1), np.full((len(x), 1), t), goals)
        with torch.no_grad():
            flow = self(*(torch.as_tensor(each, dtype=torch.float32) for each in given))
        return flow.numpy().astype(np.float64).reshape(x.shape)


@cache
def trained_field(steps: int = STEPS) -> VelocityField:
    """Train a field on simulated people by conditional flow matching."""
    velocities = torch.as_tensor(walks(CROWDS) / SCALE, dtype=torch.float32)
    goals, data = velocities.mean(1), velocities.flatten(1)
    torch.manual_seed(0)
    field = VelocityField()
    optimiser = torch.optim.Adam(field.parameters(), RATE)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    for _ in range(steps):
        picked = torch.randint(len(data), (BATCH,))
        t, noise = torch.rand(BATCH, 1), torch.randn(BATCH, data.shape[1])
        wanted = data[picked] - noise
        found = field(t * data[picked] + (1 - t) * noise, t, goals[picked])
        optimiser.zero_grad()
        nn.functional.mse_loss(found, wanted).backward()
        optimiser.step()
        schedule.step()
    return field.eval()


def walks(crowds: int) -> Array:
    """Return velocities [W, TICKS, 2] m/s of simulated people who cross open ground."""
    found = []
    for seed in range(crowds):
        rng = np.random.default_rng([seed, 7])
        simulator = pyrvo.RVOSimulator()  # pyright: ignore[reportAttributeAccessIssue]
        simulator.set_time_step(TICK_S)
        goals = rng.uniform(-HALF, HALF, (WALKERS, 2))
        pace = rng.uniform(*SPEEDS, (WALKERS, 1))
        for place in rng.uniform(-HALF, HALF, (WALKERS, 2)):
            simulator.add_agent(tuple(place.tolist()), 5.0, 8, 2.0, 1.0, RADIUS, SPEEDS[1])
        moves = []
        for _ in range(round(WALK_S / TICK_S)):
            places = np.array([_pair(simulator.get_agent_position(n)) for n in range(WALKERS)])
            way = goals - places
            arrived = np.linalg.norm(way, axis=1) < CONTACT
            goals[arrived] = rng.uniform(-HALF, HALF, (int(arrived.sum()), 2))
            wanted = pace * way / (np.linalg.norm(way, axis=1, keepdims=True) + 1e-9)
            for n, velocity in enumerate(wanted + rng.normal(0.0, 0.05, way.shape)):
                simulator.set_agent_pref_velocity(n, tuple(velocity.tolist()))
            simulator.do_step()
            moves.append([_pair(simulator.get_agent_velocity(n)) for n in range(WALKERS)])
        walked = np.array(moves).swapaxes(0, 1)
        found += [walked[:, first : first + TICKS] for first in range(0, TICKS + 1, TICKS // 4)]
    return np.concatenate(found)


def _pair(vector: object) -> tuple[float, float]:
    return vector.x, vector.y  # pyright: ignore[reportAttributeAccessIssue]
