"""A planner's view at the moment at which its plan will arrive, as far as it can be known now.

The ego does what it knows, or keeps its speed and yaw rate; everybody else keeps their velocity.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from anchorflow_driving.geometry import (
    Array,
    arc_ends,
    at_places,
    into_frame,
    out_of_frame,
    states_into_frame,
)
from anchorflow_driving.log import FRAME_S
from anchorflow_driving.route import Route
from anchorflow_driving.window import EgoState, PlannerView


def to_come(view: PlannerView, seconds: float, meanwhile: Array | None) -> tuple[Array, Array]:
    """Return poses [F, 3] in the ego's frame at every frame from now, and its speeds [F].

    meanwhile: [K, 4] s, x, y, heading of what the ego does until then; None: it keeps its rates
    """
    times = np.asarray(FRAME_S * np.arange(round(seconds / FRAME_S) + 1), np.float64)
    speed = view.state.speed
    if meanwhile is None:
        poses = arc_ends(speed * times, speed * view.state.curvature * times)
        return poses, np.full(len(times), speed)
    known = meanwhile.copy()
    known[:, 3] = np.unwrap(known[:, 3])
    rates = np.gradient(known[:, 1:3], known[:, 0], axis=0)
    along = rates[:, 0] * np.cos(known[:, 3]) + rates[:, 1] * np.sin(known[:, 3])
    along[0] = speed
    return at_places(times, known[:, 0], known[:, 1:]), np.interp(times, known[:, 0], along)


def moved_on(view: PlannerView, seconds: float, meanwhile: Array | None) -> PlannerView:
    """Return the view some whole frames later, in the frame in which the ego then is."""
    poses, speeds = to_come(view, seconds, meanwhile)
    frames = len(poses) - 1
    if not frames:
        return view
    later = np.repeat(view.tracks[:, -1:], frames, 1)
    later[..., :2] += FRAME_S * np.arange(1, frames + 1)[:, None] * later[..., 3:]
    heading = poses[1:, 2]
    velocity = speeds[1:, None] * np.stack([np.cos(heading), np.sin(heading)], -1)
    later[view.ego] = np.concatenate([view.vehicle.middles(poses[1:]), velocity], -1)
    tracks, end = np.concatenate([view.tracks[:, frames:], later], 1), poses[-1]
    state = EgoState(
        pose=out_of_frame(end, view.state.pose),
        speed=max(float(speeds[-1]), 0.0),
        acceleration=(float(speeds[-1]) - view.state.speed) / seconds,
        curvature=view.state.curvature,
    )
    return replace(
        view,
        state=state,
        tracks=states_into_frame(tracks, end),
        route=Route(into_frame(view.route.points, end)),
    )
