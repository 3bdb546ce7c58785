"""A robot that obeys an `MppiController` exactly, on a known map."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_client import CostMap
from anchorflow_control import Command, MppiController, Robot

Array = NDArray[np.float64]

SUBSTEPS = 10


def square_map(*walls: tuple[slice, slice], channels: int = 1) -> CostMap:
    """Return a map of 10 m about (0, 0) in cells of 0.1 m, occupied in [rows, columns]."""
    data = np.zeros((channels, 100, 100), np.float32)
    for rows, columns in walls:
        data[0, rows, columns] = 1.0
    return CostMap.build(data, 0.1)


def later(robot: Robot, state: Array, u: Array, seconds: float) -> Array:
    """Return the state after the velocities have changed to a command's, evenly."""
    state, dt = state.copy(), seconds / SUBSTEPS
    for change in np.repeat((u - state[None, 3:]) / SUBSTEPS, SUBSTEPS, axis=0):
        first, second = state[3:] + 0.5 * change
        if robot.is_omni:
            state[:2] += dt * np.array([first, second])
        else:
            course = state[2] + 0.5 * dt * second
            state[:3] += dt * np.array([first * np.cos(course), first * np.sin(course), second])
        state[3:] += change
    return state


@dataclass(frozen=True)
class Drive:
    """states: [K + 1, 5], at the ticks; commands: K."""

    states: Array
    commands: list[Command]

    @property
    def places(self) -> Array:
        return self.states[:, :2]


def drive(
    controller: MppiController,
    state: Array | list[float],
    *,
    ticks: int,
    at_tick: Callable[[int, Array], dict[str, Any]],
) -> Drive:
    """Drive; `at_tick` gets the tick and the state, and returns the arguments of `command`."""
    states, commands = [np.asarray(state, np.float64)], []
    for tick in range(ticks):
        commands.append(controller.command(states[-1], **at_tick(tick, states[-1])))
        states.append(later(controller.robot, states[-1], commands[-1].u, controller.tick_s))
    return Drive(np.array(states), commands)
