"""Motions that were rolled out, and what may be driven of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_control.dynamics import braking, step
from anchorflow_control.rollout import Task, roll_out
from anchorflow_trajectory.compiled import compiled

Floats = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Motions:
    """controls: [K,T,2]; costs: [K]; states: [K,T,5]; rooms: [K,T] m beside the body."""

    controls: Floats
    costs: Floats
    states: Floats
    rooms: Floats

    @staticmethod
    def under(task: Task, controls: Floats) -> Motions:
        """Roll out controls [K,T,2]."""
        count, steps, _ = controls.shape
        costs = np.empty(count, np.float32)
        states, rooms = (
            np.empty((count, steps, 5), np.float32),
            np.empty((count, steps), np.float32),
        )
        roll_out(task, controls, costs, states, rooms)
        return Motions(controls, costs, states, rooms)

    def collides_after(self, k: int, floor: float) -> int:
        """Return the steps that motion k stays at least `floor` m from everything."""
        low = self.rooms[k] < floor
        return int(low.argmax()) if low.any() else len(low)


@compiled
def braking_controls(task: Task, controls: Floats) -> None:
    """Write the controls [T,2] of the hardest braking."""
    start = task.start
    state = (start[0], start[1], start[2], start[3], start[4])
    for t in range(len(controls)):
        first, second = braking(task.limits, state, task.dt)
        controls[t, 0], controls[t, 1] = first, second
        state = step(task.limits, state, first, second, task.dt)
