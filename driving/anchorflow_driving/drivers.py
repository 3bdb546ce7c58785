"""Rule-based drivers: baselines of a learned planner, and the record itself.

Each takes a window and returns poses [T, 3] of the rear axle in the ego's frame, at times [s].
All but `human` read the window's `view` alone.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from anchorflow_driving.geometry import Array, arc_ends, out_of_frame, wrap_angle
from anchorflow_driving.log import FRAME_S
from anchorflow_driving.pdm.collisions import boxes_touch
from anchorflow_driving.pdm.pdm_closed import pdm_closed
from anchorflow_driving.pdm.traffic import recorded_traffic, seen_traffic
from anchorflow_driving.window import Window
from anchorflow_trajectory.car.tracking import PLAN_TIMES

WAYPOINT_TIMES: Array = np.arange(1, 46, dtype=np.float64) * FRAME_S
"""s, of 45 waypoints."""

DENSE_TIMES: Array = np.arange(1, 41, dtype=np.float64) * FRAME_S
"""s, of 40 poses, which the PDM score takes as well."""

BRAKING = 3.0  # m/s²
SHARPEST_CURVATURE = 0.2  # 1/m
RETURN_S = 3.0  # in which an offset from the route fades
STANDING = 0.05
"""m between two waypoints, at or below which a vehicle keeps its heading."""


class Driver(Protocol):
    """A plan of a window; NaN where a driver does not plan that far."""

    def __call__(self, window: Window, times: Array = PLAN_TIMES) -> Array: ...


def human(window: Window, times: Array = PLAN_TIMES) -> Array:
    """Drive the record: no planner, since it knows the future."""
    return window.recorded(times)


def constant_velocity(window: Window, times: Array = PLAN_TIMES) -> Array:
    """Straight on at the present speed."""
    return np.stack([window.view.state.speed * times, 0 * times, 0 * times], axis=-1)


def route_constant_speed(window: Window, times: Array = PLAN_TIMES) -> Array:
    """Along the route at the present speed; its offset from the route fades."""
    view = window.view
    start, left = view.route.project(np.zeros(2))
    fading = np.maximum(0.0, 1 - times / RETURN_S)
    poses = view.route.poses(start + view.state.speed * times, left * fading)
    poses[:, 2] = wrap_angle(poses[:, 2])
    return poses


def stop(window: Window, times: Array = PLAN_TIMES) -> Array:
    """Brakes to a halt along the present arc."""
    state = window.view.state
    time = np.minimum(times, state.speed / BRAKING)
    distance = state.speed * time - BRAKING / 2 * time**2
    curvature = np.clip(state.curvature, -SHARPEST_CURVATURE, SHARPEST_CURVATURE)
    return arc_ends(distance, curvature * distance)


def idm(window: Window, times: Array = PLAN_TIMES) -> Array:
    """PDM-Closed among the others as seen now, perfectly; it plans 4 s."""
    poses = pdm_closed(seen_traffic(window.view)).poses
    step = np.rint(np.asarray(times) / FRAME_S).astype(int)
    plan = np.full((len(step), 3), np.nan)
    plan[step < len(poses)] = poses[step[step < len(poses)]]
    plan[:, 2] = wrap_angle(plan[:, 2])
    return plan


DRIVERS: dict[str, Driver] = {
    "human": human,
    "idm": idm,
    "route_constant_speed": route_constant_speed,
    "constant_velocity": constant_velocity,
    "stop": stop,
}


def collides(window: Window, waypoints: Array) -> bool:
    """Whether the ego's box, untracked, overlaps a recorded one at any waypoint [T, 2], T <= 45."""
    poses = np.concatenate([waypoints, waypoint_headings(waypoints)[:, None]], axis=-1)
    traffic = recorded_traffic(window)
    middles = traffic.vehicle.middles(out_of_frame(poses, traffic.start.pose))
    return bool(boxes_touch(middles[None], traffic.vehicle, traffic.others)[0])


def waypoint_headings(waypoints: Array) -> Array:
    """[T] the course from each waypoint's predecessor; the first starts at the origin."""
    step = np.diff(waypoints, axis=0, prepend=np.zeros((1, 2)))
    moves = np.hypot(*step.T) > STANDING
    # The last moving step up to each; index 0 stands for the ego's own heading.
    last = np.maximum.accumulate(np.where(moves, np.arange(1, len(step) + 1), 0))
    return np.concatenate([[0.0], np.arctan2(step[:, 1], step[:, 0])])[last]
