"""A planner's view at the moment at which its plan will arrive, as far as it can be known now.

The ego does what it knows, or keeps its speed and yaw rate; everybody else keeps their velocity.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from anchorflow_driving.geometry import Array, into_frame, out_of_frame, states_into_frame
from anchorflow_driving.log import FRAME_S
from anchorflow_driving.route import Route
from anchorflow_driving.window import EgoState, PlannerView
from anchorflow_trajectory.late import Departure


def departure_of(view: PlannerView, seconds: float, meanwhile: Array | None) -> Departure:
    """Return where the ego will be, in its frame.

    meanwhile: [K, 4] s, x, y, heading of what it does until then; None: it keeps its rates
    """
    speed = view.state.speed
    if meanwhile is not None:
        return Departure.along(seconds, meanwhile, speed=speed)
    yaw_rate = speed * view.state.curvature
    return Departure.at_constant_rates(seconds, speed=speed, yaw_rate=yaw_rate)


def moved_on(view: PlannerView, seconds: float, meanwhile: Array | None) -> PlannerView:
    """Return the view some whole frames later, in the frame in which the ego then is."""
    frames = round(seconds / FRAME_S)
    steps = [departure_of(view, FRAME_S * frame, meanwhile) for frame in range(1, frames + 1)]
    if not steps:
        return view
    later = np.repeat(view.tracks[:, -1:], frames, 1)
    later[..., :2] += FRAME_S * np.arange(1, frames + 1)[:, None] * later[..., 3:]
    for frame, step in enumerate(steps):
        heading = step.pose[2]
        velocity = step.speed * np.array([np.cos(heading), np.sin(heading)])
        later[view.ego, frame] = [*view.vehicle.middles(step.pose), *velocity]
    tracks, end = np.concatenate([view.tracks[:, frames:], later], 1), steps[-1]
    state = EgoState(
        pose=out_of_frame(end.pose, view.state.pose),
        speed=end.speed,
        acceleration=(end.speed - view.state.speed) / seconds,
        curvature=view.state.curvature,
    )
    return replace(
        view,
        state=state,
        tracks=states_into_frame(tracks, end.pose),
        route=Route(into_frame(view.route.points, end.pose)),
    )
