"""Plans, commands and faults as messages."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed: pip install 'anchorflow[ros]'")

from rclpy.serialization import deserialize_message, serialize_message
from visualization_msgs.msg import Marker

from anchorflow_client import AnchorBatch
from anchorflow_client.contract import ModelId
from anchorflow_ros import outputs
from anchorflow_ros.faults import ERROR, OK, Fault
from anchorflow_ros.frames import poses_of

T = 9


def batch(safe: tuple[bool, ...] = (True, True, False), **changed: Any) -> AnchorBatch:
    """Three anchors along x, y and -x at 1 m/s, of 2, 4 and 2 s; the first one is the best."""
    dt = np.array([0.25, 0.5, 0.25])
    way = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]])
    at = dt[:, None] * np.arange(T)
    arrays = {
        "trajectories": at[..., None] * way[:, None],
        "velocities": np.broadcast_to(way[:, None], (3, T, 2)),
        "accelerations": np.zeros((3, T, 2)),
        "scores": np.array([-1.0, -3.0, -2.0]),
        "safe": np.array(safe),
    }
    return AnchorBatch(
        arrays=arrays | changed, dt=dt, seed=0, model=ModelId("m", "1", ""), timing_ms={}
    )


def seconds(stamp: Any) -> float:
    return stamp.sec + 1e-9 * stamp.nanosec


def test_a_path_has_the_times_and_headings_of_its_anchor() -> None:
    path: Any = outputs.path_of(batch(), 1, outputs.header_of(10.25, "map"))

    assert len(path.poses) == T
    last = path.poses[-1]
    assert (last.header.frame_id, seconds(last.header.stamp)) == ("map", pytest.approx(14.25))
    assert (last.pose.position.x, last.pose.position.y) == (0.0, pytest.approx(4.0))
    assert last.pose.orientation.z == pytest.approx(np.sin(np.pi / 4))


def test_an_anchor_that_stands_keeps_its_heading() -> None:
    velocities = batch().velocities.copy()
    velocities[1, 0] = velocities[1, -1] = 0.0

    poses = poses_of(batch(velocities=velocities), 1)

    np.testing.assert_allclose(poses[:, 2], np.pi / 2)


def test_a_trajectory_has_velocities_and_times() -> None:
    made: Any = outputs.trajectory_of(batch(), 0, outputs.header_of(10.0, "map"))

    assert [seconds(point.time_from_start) for point in made.points] == pytest.approx(
        [0.25 * k for k in range(T)]
    )
    assert made.points[3].velocities[0].linear.x == 1.0
    assert made.points[3].transforms[0].translation.x == pytest.approx(0.75)
    assert made.joint_names == ["base"]


def test_candidates_are_coloured_by_score_and_unsafe_ones_dashed() -> None:
    made: Any = outputs.candidates_of(batch(), outputs.header_of(10.0, "map"))
    safe, unsafe = made.markers

    whole, dashed = 2 * (T - 1), 2 * (T // 2)
    assert (len(safe.points), len(unsafe.points)) == (2 * whole, dashed)
    assert len(safe.colors) == len(safe.points)
    best, worst = safe.colors[0], safe.colors[-1]
    assert (best.r, best.g) == pytest.approx(outputs.BEST[:2])
    assert (worst.r, worst.g) == pytest.approx(outputs.WORST[:2])
    assert unsafe.colors[0].r == pytest.approx(outputs.UNSAFE[0])
    assert safe.points[1].x == safe.points[2].x  # segments follow each other
    assert unsafe.points[1].x != unsafe.points[2].x  # and leave gaps if dashed


def test_without_unsafe_anchors_their_marker_is_removed() -> None:
    made: Any = outputs.candidates_of(batch((True,) * 3), outputs.header_of(10.0, "map"))

    assert [marker.action for marker in made.markers] == [Marker.ADD, Marker.DELETE]


def test_a_fault_is_the_nodes_status_and_its_own() -> None:
    faults = [Fault("goal", OK, "none"), Fault("map", ERROR, "no message has arrived")]

    made: Any = outputs.diagnostics_of(
        faults, {"rate Hz": 20.0}, name="a/node", header=outputs.header_of(10.0, "")
    )

    summary, *parts = made.status
    assert (summary.name, summary.level) == ("a/node", b"\x02")
    assert summary.message == "map: no message has arrived"
    assert [(each.key, each.value) for each in summary.values] == [("rate Hz", "20.0")]
    assert [part.name for part in parts] == ["a/node: goal", "a/node: map"]


def test_all_messages_survive_the_wire() -> None:
    header = outputs.header_of(10.0, "map")
    markers: Any = outputs.candidates_of(batch(), header)
    for message in (
        outputs.twist_of(np.array([0.5, 0.0, -0.2]), header),
        outputs.path_of(batch(), 0, header),
        outputs.trajectory_of(batch(), 0, header),
        markers.markers[0],
        outputs.diagnostics_of([], {}, name="node", header=header),
    ):
        sent = deserialize_message(serialize_message(message), type(message))
        assert sent.header == header
        assert deserialize_message(serialize_message(sent), type(message)) == sent
