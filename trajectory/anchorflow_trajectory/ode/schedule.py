"""Schedules of flow time, and the times at which a method evaluates the field on one.

Flow time runs from t = 0 (noise) to t = 1 (data).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory.ode.methods import Method

Schedule = tuple[float, ...]


@dataclass(frozen=True)
class StageTimes:
    """The times at which a method evaluates the field on a schedule.

    times: float32 [K], the distinct flow times in ascending order
    index: [steps][stages], which of them each stage uses
    """

    times: NDArray[np.float32]
    index: tuple[tuple[int, ...], ...]


def check_schedule(schedule: Schedule) -> Schedule:
    """The schedule itself, if it has a step, rises strictly within [0, 1] and ends at 1."""
    rises = all(start < end for start, end in pairwise(schedule))
    if len(schedule) < 2 or not rises or schedule[0] < 0.0 or schedule[-1] != 1.0:
        raise ValueError(
            f"expected at least two flow times in [0, 1], strictly rising to 1, got {schedule}"
        )
    return schedule


def remaining(schedule: Schedule, tau: float) -> Schedule:
    """The part of a schedule that is left from flow time tau on, for a warm start."""
    return (tau, *(t for t in schedule if t > tau))


@lru_cache(maxsize=64)
def stage_times(method: Method, schedule: Schedule) -> StageTimes:
    """The distinct stage times of a method on a schedule; 17 for rk4 on the 8-step one."""
    # Weighing both ends makes c = 0 and c = 1 land on them exactly, so that steps share their ends.
    stages = [
        [start * (1.0 - c) + end * c for c in method.c]
        for start, end in pairwise(check_schedule(schedule))
    ]
    distinct = sorted({time for step in stages for time in step})
    position = {time: k for k, time in enumerate(distinct)}
    times = np.array(distinct, np.float32)
    times.flags.writeable = False
    return StageTimes(times, tuple(tuple(position[time] for time in step) for step in stages))


def stage_strides(method: Method, schedule: Schedule) -> tuple[float, ...]:
    """[K]: of each distinct stage time the length of the step, the longest where steps share it."""
    stages = stage_times(method, schedule)
    strides = [0.0] * len(stages.times)
    for (start, end), step in zip(pairwise(schedule), stages.index, strict=True):
        for k in step:
            strides[k] = max(strides[k], end - start)
    return tuple(strides)
