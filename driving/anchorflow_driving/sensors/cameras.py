"""Simulated cameras: the three that NAVSIM's planners look through, and one at the roadside."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.sensors import stitch_cameras
from anchorflow_driving.geometry import out_of_frame
from anchorflow_driving.sensors.pinhole import COLUMNS, REFERENCE_CAMERAS, ROWS, PinholeCamera
from anchorflow_driving.sensors.rendering import Renderer
from anchorflow_driving.window import PlannerView

Bytes = NDArray[np.uint8]

POLE_HEIGHT = 6.0  # m
POLE_AHEAD = (15.0, 45.0)
"""m before the ego at which a roadside camera stands: at the next junction, if there is one."""
POLE_ASIDE = 8.0  # m
POLE_FOCAL = 1.1
"""Focal length in widths of its picture."""


def camera_images(view: PlannerView, renderer: Renderer) -> tuple[Bytes, Bytes, Bytes]:
    """Left, front and right [270, 480, 3]."""
    left, front, right = (renderer.draw(view, camera) for camera in REFERENCE_CAMERAS)
    return left, front, right


def simulated_camera(view: PlannerView, renderer: Renderer) -> Bytes:
    """The three cameras stitched: uint8 [3, 256, 1024]."""
    return stitch_cameras(*camera_images(view, renderer))


def roadside_camera(view: PlannerView) -> PinholeCamera:
    """A camera on a pole beside the road ahead, which looks back over the junction at the ego."""
    place = _pole(view)
    aim = np.array([place[0] / 2, 0.0]) - place
    away = float(np.hypot(*aim))
    return PinholeCamera(
        place=(float(place[0]), float(place[1]), POLE_HEIGHT),
        yaw=float(np.arctan2(aim[1], aim[0])),
        pitch=-float(np.arctan2(POLE_HEIGHT, away)),
        focal=POLE_FOCAL * COLUMNS,
        rows=ROWS,
        columns=COLUMNS,
    )


def simulated_roadside(view: PlannerView, renderer: Renderer) -> Bytes:
    """Draw the roadside camera's picture, the ego included: uint8 [270, 480, 3]."""
    return renderer.draw(view, roadside_camera(view), with_ego=True)


def _pole(view: PlannerView) -> NDArray[np.float64]:
    """[2] beside the route, at the first junction lane that begins ahead."""
    start, _ = view.route.project(np.zeros(2))
    near, far = POLE_AHEAD
    ahead = view.route.poses(start + np.arange(near, far, 1.0))
    junction = view.road.in_junction(
        view.road.in_lanes(out_of_frame(ahead[:, :2], view.state.pose))
    )
    found = np.flatnonzero(junction)
    pose = ahead[found[0]] if len(found) else ahead[-1]
    side = -POLE_ASIDE
    return pose[:2] + side * np.array([-np.sin(pose[2]), np.cos(pose[2])])
