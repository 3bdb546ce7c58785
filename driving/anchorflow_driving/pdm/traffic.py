"""The scene that motions are judged in: road, route, the ego's box, and the others over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.geometry import Array, out_of_frame
from anchorflow_driving.log import FRAME_S
from anchorflow_driving.road import Road
from anchorflow_driving.route import Route
from anchorflow_driving.window import EgoState, PlannerView, Vehicle, Window
from anchorflow_trajectory.car.following import UNKNOWN_SPEED_LIMIT
from anchorflow_trajectory.car.tracking import STEPS

FRAMES = STEPS + 10
"""Of the others: time to collision looks 0.9 s past the last step."""
PERCEPTION_RANGE = 120.0  # m, for predictions


@dataclass(frozen=True)
class Others:
    """Everybody but the ego, from now on."""

    states: Array  # [K, FRAMES, 5] x, y, heading, vx, vy of the boxes' middles; NaN where absent
    size: Array  # [K, 2] length, width
    kind: NDArray[np.uint8]  # [K] as in a log's track_type

    def of(self, tracks: NDArray[np.bool_]) -> Others:
        return Others(self.states[tracks], self.size[tracks], self.kind[tracks])

    def present(self, place: Array) -> Others:
        """Those that are there now, within PERCEPTION_RANGE of a place [2]."""
        away = np.linalg.norm(self.states[:, 0, :2] - place, axis=-1)
        return self.of(away < PERCEPTION_RANGE)  # not of NaN

    def predicted(self) -> Others:
        """The same at constant velocity and heading."""
        states = np.repeat(self.states[:, :1], FRAMES, axis=1)
        states[..., :2] += np.arange(FRAMES)[:, None] * FRAME_S * states[..., 3:]
        return Others(states, self.size, self.kind)


@dataclass(frozen=True)
class Traffic:
    """A window for the score; all in the log's frame."""

    road: Road
    route: Route
    vehicle: Vehicle
    start: EgoState
    speed_limit: float  # m/s
    others: Others

    def predicted(self) -> Traffic:
        """The others at constant velocity, those that are there now."""
        others = self.others.present(self.start.pose[:2]).predicted()
        return Traffic(self.road, self.route, self.vehicle, self.start, self.speed_limit, others)


def recorded_traffic(window: Window) -> Traffic:
    """Return a window's traffic with the others as recorded."""
    log, frame = window.log, window.frame
    recorded = log.track_state[:, frame : frame + FRAMES].astype(np.float64)
    states = np.full((len(recorded), FRAMES, 5), np.nan)
    states[:, : recorded.shape[1]] = recorded
    everybody = Others(states, log.track_size.astype(np.float64), log.track_type)
    return Traffic(
        road=window.road,
        route=window.route,
        vehicle=window.vehicle,
        start=window.state,
        speed_limit=_known_limit(window.speed_limit),
        others=everybody.of(np.arange(len(states)) != window.ego),
    )


def seen_traffic(view: PlannerView) -> Traffic:
    """Return the traffic that a planner sees now, with the others predicted."""
    pose = view.state.pose
    now = view.tracks[:, -1:]
    turn = np.array([0.0, 0.0, pose[2]])
    states = np.concatenate(
        [out_of_frame(now[..., :3], pose), out_of_frame(now[..., 3:], turn)], axis=-1
    )
    everybody = Others(states, view.track_size, view.track_type)
    others = everybody.of(np.arange(len(states)) != view.ego)
    return Traffic(
        road=view.road,
        route=view.route.moved(pose),
        vehicle=view.vehicle,
        start=view.state,
        speed_limit=_known_limit(view.speed_limit),
        others=others.present(pose[:2]).predicted(),
    )


def _known_limit(speed_limit: float) -> float:
    return speed_limit if np.isfinite(speed_limit) else UNKNOWN_SPEED_LIMIT
