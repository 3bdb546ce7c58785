"""MPPI (Williams et al., 2017) from the `pytorch_mppi` package, helped by anchors or alone.

Anchors are warm starts: the robot's model drives along the shortest clear ones, and where one of
these motions costs less than the plan that is held, MPPI goes on from it. What MPPI then makes of
it is taken where it is no worse. Every such motion takes the place of one of MPPI's samples, so
that each tick rolls out the same number with and without. Clear anchors also tell the way that is
left beyond the horizon (`ways_left`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import torch
from pytorch_mppi import MPPI
from pytorch_mppi.mppi import SpecificActionSampler
from torch import Tensor

from anchorflow_benchmarks.closed_loop.clearance_grid import ClearanceGrid
from anchorflow_benchmarks.closed_loop.navigation_cost import NavigationCost, rollout
from anchorflow_benchmarks.closed_loop.path_following import motions_along
from anchorflow_benchmarks.closed_loop.robots import Robot
from anchorflow_benchmarks.closed_loop.ways_left import WaysLeft, clear_ways

STANDING = 2  # motions that need no anchor: the plan that is held, and braking
TRIED_SHARE = 0.25  # of the motions of a tick, that may be along anchors
KEPT_S = 2.0  # for which clear ways count, where the next answers have none
BLOCKED_WAY = 100.0  # m by which one that is not clear counts as longer


@dataclass(frozen=True)
class MppiConfig:
    """samples: motions rolled out a tick, anchors included; steps of dt s: how far they look ahead.

    temperature: lambda of MPPI; noise: standard deviation of the controls, as a share of their
    limits; cruise: share of v_max at which anchors without a time law of their own are driven
    """

    samples: int = 512
    steps: int = 30
    dt: float = 0.1
    temperature: float = 0.1
    noise: float = 0.4
    cruise: float = 0.75
    cost: NavigationCost = field(default_factory=NavigationCost)


class HeldPlan(SpecificActionSampler):
    """The controls [T, U] that MPPI goes on from, also one of its samples.

    Without it, an update may leave a good plan for the best of many bad disturbances of it.
    """

    def __init__(self, plan: Tensor) -> None:
        super().__init__()
        self.plan = plan

    def sample_trajectories(self, state: Tensor, info: Any) -> Tensor:  # noqa: ARG002 the package's
        """[1, T, U]."""
        return self.plan[None]


class MppiController:
    """Controls of one robot on its way; draws from torch's global generator."""

    def __init__(self, robot: Robot, config: MppiConfig, *, tick_s: float) -> None:
        """tick_s: between two commands; a plan's own steps may be longer."""
        self.robot, self.config = robot, config
        self._tick_s = tick_s
        limit = robot.control_limit
        self._held = HeldPlan(torch.zeros(config.steps, len(limit)))
        self._mppi = MPPI(
            self._dynamics,
            self._no_running_cost,
            robot.state_size,
            torch.diag((config.noise * limit) ** 2),
            num_samples=config.samples,
            horizon=config.steps,
            lambda_=config.temperature,
            terminal_state_cost=self._cost,
            u_min=-limit,
            u_max=limit,
            U_init=self._held.plan,
            specific_action_sampler=self._held,
        )
        self._grid: ClearanceGrid
        self._goal: Tensor
        self._ways: WaysLeft | None = None
        self._ways_kept = 0

    def command(
        self,
        state: Tensor,
        *,
        grid: ClearanceGrid,
        goal: Tensor,
        paths: Tensor | None = None,
        paces: Tensor | None = None,
        handicap: Tensor | None = None,
    ) -> tuple[Tensor, int | None]:
        """The control [U] for a state [X], and which path it goes on from.

        grid: of what is known; goal: [2] m; paths: [M, S, 2] m, anchors from where the robot is;
        paces: [M, S] m/s at which they want to be driven, None for the cruise of MppiConfig;
        handicap: [M] m by which each counts as longer than it is. The second is None where MPPI
        keeps the plan that it has.
        """
        self._grid, self._goal = grid, goal
        self._ways_kept -= 1
        if self._ways_kept <= 0:
            self._ways = None
        self._shift()
        plans, motions = self._standing_plans(state)
        tried: list[int] = []
        if paths is not None:
            tried = self._worth_trying(paths, handicap)
            ways, pace = paths[tried], None if paces is None else paces[tried]
            controls, driven = self._along(state, ways, pace)
            plans, motions = torch.cat([plans, controls]), torch.cat([motions, driven])
        costs = self._cost(motions[None], plans[None])
        best = int(costs.argmin())
        self._held.plan = plans[best]
        self._mppi.K = self.config.samples - len(plans) - 1
        self._mppi.U = self._held.plan
        self._mppi.command(state, shift_nominal_trajectory=False)
        improved = self._mppi.get_action_sequence()
        assert improved is not None
        # The mean of good motions past both sides of a post is a bad one.
        motion = rollout(self.robot, state, improved[None], self.config.dt)
        if float(self._cost(motion[None], improved[None, None])) < float(costs[best]):
            self._held.plan = improved
        chosen = best - STANDING
        return self._held.plan[0], tried[chosen] if chosen >= 0 else None

    def rest(self) -> None:
        """Forget the plan: the robot brakes."""
        self._held.plan = torch.zeros_like(self._held.plan)

    def planned(self, state: Tensor) -> Tensor:
        """States [T, X] ahead of [X] as they are planned."""
        return rollout(self.robot, state, self._held.plan[None], self.config.dt)[0]

    def _shift(self) -> None:
        """Let a tick of the plan pass; what comes in at its end is rest."""
        plan, share = self._held.plan, self._tick_s / self.config.dt
        later = torch.cat([plan[1:], torch.zeros_like(plan[:1])])
        self._held.plan = (1.0 - share) * plan + share * later

    def _standing_plans(self, state: Tensor) -> tuple[Tensor, Tensor]:
        """The plan that is held and that of braking: controls [2, T, U], states [2, T, X]."""
        robot, config = self.robot, self.config
        held = self._held.plan[None]
        now, controls, states = state[None], [], []
        for _ in range(config.steps):
            controls.append(robot.braking(now[0], config.dt)[None])
            now = robot.step(now, controls[-1], config.dt)
            states.append(now)
        motion = rollout(robot, state, held, config.dt)
        return (
            torch.cat([held, torch.stack(controls, 1)]),
            torch.cat([motion, torch.stack(states, 1)]),
        )

    def _worth_trying(self, paths: Tensor, handicap: Tensor | None) -> list[int]:
        """Paths that are driven along, the shortest clear ones first; takes note of the ways left.

        Where none is clear the last clear ones count for a while, and then the goal's distance.
        """
        clear = clear_ways(paths, self._grid, self.config.cost.margin)
        extra = torch.zeros(len(paths)) if handicap is None else handicap
        if bool(clear.any()):
            self._ways = WaysLeft.along(paths[clear], self._goal, extra[clear])
            self._ways_kept = round(KEPT_S / self._tick_s)
        lengths = torch.diff(paths, dim=1).norm(dim=-1).sum(1) + extra
        order = (lengths + BLOCKED_WAY * ~clear).argsort()
        return order[: int(TRIED_SHARE * self.config.samples)].tolist()

    def _along(self, state: Tensor, paths: Tensor, paces: Tensor | None) -> tuple[Tensor, Tensor]:
        config = self.config
        return motions_along(
            self.robot,
            paths,
            state,
            steps=config.steps,
            dt=config.dt,
            speed=config.cruise * self.robot.v_max,
            paces=paces,
        )

    def _dynamics(self, state: Tensor, control: Tensor) -> Tensor:
        return self.robot.step(state, control, self.config.dt)

    def _no_running_cost(self, state: Tensor, _: Tensor) -> Tensor:
        """All is in the cost of the whole motion: one look at the map for all its steps."""
        return torch.zeros(len(state))

    def _cost(self, states: Tensor, controls: Tensor) -> Tensor:
        """J [K] of what pytorch_mppi calls the terminal cost: [1, K, T, X] and [1, K, T, U]."""
        return self.config.cost.of(
            self.robot,
            states[0],
            controls[0],
            grid=self._grid,
            goal=self._goal,
            dt=self.config.dt,
            ways=self._ways,
        )
