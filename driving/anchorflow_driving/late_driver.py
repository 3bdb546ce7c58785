"""Drivers whose plans arrive late: made from what was seen a moment ago, driven from now on.

A driver may know: a `BundleDriver` by the request field `delay_s`, and any by the times of its
poses (`by_time`), or by seeing what will be there when its plan arrives (`moved_on`). The plan of
one that does not is driven as if it were on time.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import numpy as np

from anchorflow_driving.bundle_driver import BundleDriver
from anchorflow_driving.drivers import PLAN_TIMES, Driver
from anchorflow_driving.geometry import Array, at_places, into_frame, out_of_frame
from anchorflow_driving.moved_on import moved_on, to_come
from anchorflow_driving.window import Window


def begins_s(driver: Driver) -> float:
    """Return s from what a driver sees to the moment from which it counts the times of a plan."""
    return driver.delay_s if isinstance(driver, BundleDriver | ByTime | MovedOn) else 0.0


@dataclass(frozen=True, eq=False)
class ByTime:
    """Any driver, whose poses are driven at their times: those of the delay are left out.

    Beyond its last pose a plan goes on as in its last step.
    """

    driver: Driver
    delay_s: float

    def __call__(self, window: Window, times: Array = PLAN_TIMES) -> Array:
        """Return poses [T, 3] at `times` (s) after the delay, in the window's frame."""
        plan = self.driver(window, PLAN_TIMES)
        further = plan[-1] + (plan[-1] - plan[-2])
        poses = np.concatenate([np.zeros((1, 3)), plan, further[None]])
        poses[:, 2] = np.unwrap(poses[:, 2])
        step = PLAN_TIMES[-1] - PLAN_TIMES[-2]
        marks = np.concatenate([[0.0], PLAN_TIMES, [PLAN_TIMES[-1] + step]])
        return at_places(self.delay_s + times, marks, poses)


@dataclass(frozen=True, eq=False)
class MovedOn:
    """Any driver that reads views alone, who sees what will be there when the plan arrives."""

    driver: Driver
    delay_s: float

    def __call__(self, window: Window, times: Array = PLAN_TIMES) -> Array:
        """Return poses [T, 3] at `times` (s) after the delay, in the window's frame."""
        later = copy(window)
        later.view = moved_on(window.view, self.delay_s, window.meanwhile)
        poses, _ = to_come(window.view, self.delay_s, window.meanwhile)
        return out_of_frame(self.driver(later, times), poses[-1])


@dataclass(frozen=True, eq=False)
class LateDriver:
    """Drives a window by what was to be seen `delay_s` before it."""

    driver: Driver
    delay_s: float

    def __call__(self, window: Window, times: Array = PLAN_TIMES) -> Array:
        """Return the plan [T, 3] as it arrives, in the frame of the window."""
        seen = window.before(self.delay_s)
        plan = self.driver(seen, times)
        if not begins_s(self.driver):
            return plan
        return into_frame(out_of_frame(plan, seen.state.pose), window.state.pose)


def late_drivers(driver: Driver, name: str, delay_s: float) -> dict[str, Driver]:
    """Return a driver that is told of a delay, drives by its poses' times, sees what will be there,
    and drives as if it were on time, by their names.

    Without a delay there is one; only a bundle can be told.
    """
    if not delay_s:
        return {name: driver}
    ms = f"{name}_late_{1e3 * delay_s:.0f}"
    told = {ms: driver.late(delay_s)} if isinstance(driver, BundleDriver) else {}
    others = {"by_time": ByTime(driver, delay_s), "moved_on": MovedOn(driver, delay_s)}
    return {**told, **{f"{ms}_{how}": late for how, late in others.items()}, f"{ms}_untold": driver}
