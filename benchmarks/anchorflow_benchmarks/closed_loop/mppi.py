"""MPPI (Williams et al., 2017) from the `pytorch_mppi` package, helped by anchors or alone.

Anchors are warm starts: the robot's model drives along each of them, and where one of these
motions costs less than the plan that is held, MPPI goes on from it. Every such motion takes the
place of one of MPPI's samples, so that each tick rolls out the same number with and without.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import torch
from pytorch_mppi import MPPI
from pytorch_mppi.mppi import SpecificActionSampler
from torch import Tensor

from anchorflow_benchmarks.closed_loop.navigation_cost import (
    ClearanceGrid,
    NavigationCost,
    rollout,
)
from anchorflow_benchmarks.closed_loop.path_following import motions_along
from anchorflow_benchmarks.closed_loop.robots import Robot


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

    def command(
        self,
        state: Tensor,
        *,
        grid: ClearanceGrid,
        goal: Tensor,
        paths: Tensor | None = None,
        paces: Tensor | None = None,
    ) -> tuple[Tensor, int | None]:
        """The control [U] for a state [X], and which path it goes on from.

        grid: of what is known; goal: [2] m; paths: [M, S, 2] m, anchors from where the robot is;
        paces: [M, S] m/s at which they want to be driven, None for the cruise of MppiConfig. The
        second is None where MPPI keeps the plan that it has.
        """
        self._grid, self._goal = grid, goal
        self._shift()
        chosen, tried = None, 0
        if paths is not None:
            chosen, tried = self._start_from_best(state, paths, paces), 1 + len(paths)
        self._mppi.K = self.config.samples - tried
        self._mppi.U = self._held.plan
        control = self._mppi.command(state, shift_nominal_trajectory=False)
        improved = self._mppi.get_action_sequence()
        assert improved is not None
        self._held.plan = improved
        return control, chosen

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

    def _start_from_best(self, state: Tensor, paths: Tensor, paces: Tensor | None) -> int | None:
        """Go on from the best path where it beats the plan; says which it is."""
        config, held = self.config, self._held.plan[None]
        controls, motions = motions_along(
            self.robot,
            paths,
            state,
            steps=config.steps,
            dt=config.dt,
            speed=config.cruise * self.robot.v_max,
            paces=paces,
        )
        controls = torch.cat([held, controls])
        states = torch.cat([rollout(self.robot, state, held, config.dt), motions])
        best = int(self._cost(states[None], controls[None]).argmin())
        if best == 0:
            return None
        self._held.plan = controls[best]
        return best - 1

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
        )
