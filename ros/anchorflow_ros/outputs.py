"""Plans, commands and faults as ROS messages."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import islice, pairwise
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration, Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import (
    Point,
    Pose,
    PoseStamped,
    Quaternion,
    Transform,
    Twist,
    TwistStamped,
)
from nav_msgs.msg import Path
from numpy.typing import NDArray
from std_msgs.msg import ColorRGBA, Header
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint
from visualization_msgs.msg import Marker, MarkerArray

from anchorflow_client.contract import AnchorBatch
from anchorflow_ros.faults import OK, Fault
from anchorflow_ros.frames import poses_of
from anchorflow_ros.inputs import seconds_and_nanoseconds

Array = NDArray[np.float64]

JOINT = "base"
"""Name of the one joint of a trajectory: the robot in the map."""
LINE_WIDTH = 0.02  # m
SHOWN_STEPS = 16
"""Points of a candidate."""
BEST, WORST, UNSAFE = (0.1, 0.65, 0.2), (0.95, 0.6, 0.1), (0.85, 0.1, 0.1)
"""Red, green, blue of the best and the worst score, and of anchors that are not safe."""


def header_of(seconds: float, frame_id: str) -> Header:
    sec, nanosec = seconds_and_nanoseconds(seconds)
    return Header(stamp=Time(sec=sec, nanosec=nanosec), frame_id=frame_id)


def twist_of(twist: Array, header: Header) -> TwistStamped:
    """Return the command [3], forward and left in m/s and turn rate in rad/s."""
    message = TwistStamped(header=header)
    forward, left, turn_rate = twist.tolist()
    message.twist.linear.x, message.twist.linear.y = forward, left
    message.twist.angular.z = turn_rate
    return message


def path_of(batch: AnchorBatch, index: int, header: Header) -> Path:
    """Return one anchor; `header` holds the moment at which it starts."""
    poses = []
    step_s = float(np.broadcast_to(batch.dt, len(batch.trajectories))[index])
    start = header.stamp.sec + 1e-9 * header.stamp.nanosec
    for row, (x, y, yaw) in enumerate(poses_of(batch, index).tolist()):
        pose = PoseStamped(header=header_of(start + row * step_s, header.frame_id))
        pose.pose = Pose(position=Point(x=x, y=y), orientation=_turned(yaw))
        poses.append(pose)
    return Path(header=header, poses=poses)


def trajectory_of(batch: AnchorBatch, index: int, header: Header) -> MultiDOFJointTrajectory:
    """Return one anchor with velocities and accelerations, all in the frame of `header`."""
    points = []
    step_s = float(np.broadcast_to(batch.dt, len(batch.trajectories))[index])
    velocities = batch.velocities[index, :, :2].tolist()
    accelerations = batch.accelerations[index, :, :2].tolist()
    rows = zip(poses_of(batch, index).tolist(), velocities, accelerations, strict=True)
    for row, ((x, y, yaw), velocity, acceleration) in enumerate(rows):
        sec, nanosec = seconds_and_nanoseconds(row * step_s)
        place = Transform(rotation=_turned(yaw))
        place.translation.x, place.translation.y = x, y
        points.append(
            MultiDOFJointTrajectoryPoint(
                transforms=[place],
                velocities=[_moving(*velocity)],
                accelerations=[_moving(*acceleration)],
                time_from_start=Duration(sec=sec, nanosec=nanosec),
            )
        )
    return MultiDOFJointTrajectory(header=header, joint_names=[JOINT], points=points)


def candidates_of(batch: AnchorBatch, header: Header) -> MarkerArray:
    """Return all anchors as two markers: safe ones from green to orange by score, others dashed."""
    paths = batch.trajectories[..., :2]
    shown = np.linspace(0, paths.shape[1] - 1, min(SHOWN_STEPS, paths.shape[1])).astype(int)
    safe = batch.arrays.get("safe", np.ones(len(paths), np.bool_))
    colours = _colours(batch, safe)
    lines = []
    for name, chosen, every in (("safe", safe, 1), ("unsafe", ~safe, 2)):
        line = Marker(header=header, ns=name, type=Marker.LINE_LIST, action=Marker.ADD)
        line.scale.x, line.pose.orientation.w, line.color.a = LINE_WIDTH, 1.0, 1.0
        points, hues = [], []
        for n in np.flatnonzero(chosen):
            steps = pairwise(paths[n, shown].astype(np.float64).tolist())
            for ends in islice(steps, None, None, every):
                points += [Point(x=x, y=y) for x, y in ends]
                hues += [colours[n], colours[n]]
        line.points, line.colors = points, hues
        if not points:
            line.action = Marker.DELETE
        lines.append(line)
    return MarkerArray(markers=lines)


def diagnostics_of(
    faults: Iterable[Fault], values: dict[str, Any], *, name: str, header: Header
) -> DiagnosticArray:
    """Return one status for the node, with the figures, and one for each fault."""
    faults = list(faults)
    worst = max(faults, key=lambda fault: fault.level, default=Fault("node", OK, "driving"))
    figures = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
    summary = DiagnosticStatus(
        name=name,
        level=_level(worst),
        message=f"{worst.part}: {worst.text}" if faults else worst.text,
        values=figures,
    )
    parts = [
        DiagnosticStatus(name=f"{name}: {each.part}", level=_level(each), message=each.text)
        for each in faults
    ]
    return DiagnosticArray(header=header, status=[summary, *parts])


def _level(fault: Fault) -> bytes:
    return bytes([fault.level])


def _turned(yaw: float) -> Quaternion:
    return Quaternion(z=math.sin(0.5 * yaw), w=math.cos(0.5 * yaw))


def _moving(x: float, y: float) -> Twist:
    message = Twist()
    message.linear.x, message.linear.y = x, y
    return message


def _colours(batch: AnchorBatch, safe: NDArray[np.bool_]) -> list[ColorRGBA]:
    """Return the colour of each anchor."""
    scores = batch.arrays.get("scores", np.zeros(len(safe))).astype(np.float64)
    known = scores[safe] if safe.any() else scores
    span = max(float(np.ptp(known)), 1e-9)
    share = np.clip((known.max() - scores) / span, 0.0, 1.0)[:, None]
    mixed = (1.0 - share) * np.array(BEST) + share * np.array(WORST)
    mixed[~safe] = UNSAFE
    return [ColorRGBA(r=r, g=g, b=b, a=1.0) for r, g, b in mixed.tolist()]
