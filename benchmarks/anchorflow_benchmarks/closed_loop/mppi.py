"""MPPI (Williams et al., 2017) from the `pytorch_mppi` package, alone or with anchors.

Anchors are warm starts: the robot's model drives along the shortest clear ones. If such a motion
costs less than the current plan, MPPI continues from it, and its result is kept if it is no worse.
Each of these motions replaces one of MPPI's samples, so that every tick rolls out the same number.
Clear anchors also measure the cost to go beyond the horizon.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from pytorch_mppi import MPPI
from pytorch_mppi.mppi import SpecificActionSampler
from torch import Tensor

from anchorflow_benchmarks.closed_loop.controllers import Array, Sight
from anchorflow_benchmarks.closed_loop.cost_to_go import (
    ClearanceGrid,
    CostToGo,
    NavigationCost,
    clear_paths,
    rollout,
)
from anchorflow_benchmarks.closed_loop.path_following import motions_along, timed_paths
from anchorflow_benchmarks.closed_loop.robots import Robot
from anchorflow_client.planner import Plan

STANDING = 2  # motions without an anchor: the current plan and braking
ANCHOR_SHARE = 0.25  # of the motions of a tick, at most
KEPT_S = 2.0  # that the cost to go is kept if the next answers have no clear anchor
OFF_ROUTE = 1.5  # m added to the length of anchors off the planner's route
BLOCKED_COST = 100.0  # m added to the length of an anchor that is not clear


@dataclass(frozen=True)
class MppiConfig:
    """samples: motions per tick, anchors included, of `steps` of dt s each.

    temperature: lambda of MPPI; noise: standard deviation of the controls, as a share of their
    limits; cruise: share of v_max along anchors without a time law of their own
    """

    samples: int = 512
    steps: int = 30
    dt: float = 0.1
    temperature: float = 0.1
    noise: float = 0.4
    cruise: float = 0.75
    cost: NavigationCost = field(default_factory=NavigationCost)


class HeldPlan(SpecificActionSampler):
    """The current plan [T, U], which is also one of MPPI's samples.

    Without it, an update may replace a good plan by the best of many bad disturbances.
    """

    def __init__(self, plan: Tensor) -> None:
        super().__init__()
        self.plan = plan

    def sample_trajectories(self, state: Tensor, info: Any) -> Tensor:  # noqa: ARG002 the package's
        """[1, T, U]."""
        return self.plan[None]


class MppiController:
    """Controls one robot; draws from torch's global generator."""

    def __init__(self, robot: Robot, config: MppiConfig, *, tick_s: float) -> None:
        """tick_s: between two commands; the steps of a plan may be longer."""
        self.robot, self.config = robot, config
        self._tick_s = tick_s
        limit = robot.control_limit
        self._held = HeldPlan(torch.zeros(config.steps, len(limit)))
        self._mppi = MPPI(
            lambda state, control: robot.step(state, control, config.dt),
            lambda state, _: torch.zeros(len(state)),  # `_cost` samples the map once for all steps
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
        self._to_go: CostToGo | None = None
        self._ticks_kept = 0

    def command(
        self, state: Tensor, *, sight: Sight, goal: Array, plan: Plan | None = None
    ) -> tuple[Tensor, int | None]:
        """Anchors of equal durations are driven at the cruise, others at their own pace."""
        grid = ClearanceGrid.of(
            sight.occupied,
            resolution=sight.resolution,
            origin=sight.origin,
            robot_radius=self.robot.radius,
            surface=sight.surface,
        )
        target = torch.from_numpy(np.asarray(goal, np.float32))
        if plan is None:
            return self.decide(state, grid=grid, goal=target)
        assert plan.batch is not None  # the plan is usable
        assert plan.on_route is not None
        paths, paces = timed_paths(plan, period_s=self.config.dt)
        return self.decide(
            state,
            grid=grid,
            goal=target,
            paths=paths,
            paces=paces if np.ndim(plan.batch.dt) else None,
            handicap=OFF_ROUTE * torch.from_numpy(~plan.on_route),
        )

    def decide(
        self,
        state: Tensor,
        *,
        grid: ClearanceGrid,
        goal: Tensor,
        paths: Tensor | None = None,
        paces: Tensor | None = None,
        handicap: Tensor | None = None,
    ) -> tuple[Tensor, int | None]:
        """Return the control [U] for a state [X], and the index of the path it follows or None.

        grid: of the known obstacles; goal: [2] m; paths: [M, S, 2] m, anchors from the robot's
        place; paces: [M, S] m/s along them, None for the cruise of MppiConfig; handicap: [M] m
        added to the length of each.
        """
        self._grid, self._goal = grid, goal
        self._ticks_kept -= 1
        if self._ticks_kept <= 0:
            self._to_go = None
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
        # The mean of motions past both sides of a post is a bad motion.
        motion = rollout(self.robot, state, improved[None], self.config.dt)
        if float(self._cost(motion[None], improved[None, None])) < float(costs[best]):
            self._held.plan = improved
        chosen = best - STANDING
        return self._held.plan[0], tried[chosen] if chosen >= 0 else None

    def rest(self) -> None:
        self._held.plan = torch.zeros_like(self._held.plan)

    def planned(self, state: Tensor) -> Array:
        states = rollout(self.robot, state, self._held.plan[None], self.config.dt)[0]
        return states[:, :2].numpy()

    def _shift(self) -> None:
        """Advance the plan by a tick; zero controls are appended."""
        plan, share = self._held.plan, self._tick_s / self.config.dt
        later = torch.cat([plan[1:], torch.zeros_like(plan[:1])])
        self._held.plan = (1.0 - share) * plan + share * later

    def _standing_plans(self, state: Tensor) -> tuple[Tensor, Tensor]:
        """Return the current plan and braking: controls [2, T, U], states [2, T, X]."""
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
        """Return the indices of paths to drive along, the shortest clear ones first.

        Clear paths also update the cost to go, which is kept for KEPT_S without a clear path.
        """
        clear = clear_paths(paths, self._grid, self.config.cost.margin)
        extra = torch.zeros(len(paths)) if handicap is None else handicap
        if bool(clear.any()):
            self._to_go = CostToGo.along(paths[clear], self._goal, extra[clear])
            self._ticks_kept = round(KEPT_S / self._tick_s)
        lengths = torch.diff(paths, dim=1).norm(dim=-1).sum(1) + extra
        order = (lengths + BLOCKED_COST * ~clear).argsort()
        return order[: int(ANCHOR_SHARE * self.config.samples)].tolist()

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

    def _cost(self, states: Tensor, controls: Tensor) -> Tensor:
        """Return J [K] of motions [1, K, T, X] under [1, K, T, U], the package's terminal cost."""
        return self.config.cost.of(
            self.robot,
            states[0],
            controls[0],
            grid=self._grid,
            goal=self._goal,
            dt=self.config.dt,
            to_go=self._to_go,
        )
