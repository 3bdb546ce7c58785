"""A recorded drive is replayed: plans at every tick, in a file that others read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed: pip install 'anchorflow[ros]'")
pytest.importorskip("rosbags", reason="rosbags is not installed: pip install 'anchorflow[bags]'")

from rclpy.serialization import serialize_message
from rehearsed_robot import Rehearsal, Switched
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer

from anchorflow_benchmarks.replay import figures
from anchorflow_client import InvalidRequest
from anchorflow_ros.driver import Driver
from anchorflow_ros.parameters import Settings
from anchorflow_ros.replay import STORE, AtOnce, BagError, decisions, replay
from anchorflow_service.local import LocalClient

TYPES = {
    "/map": "nav_msgs/msg/OccupancyGrid",
    "/odom": "nav_msgs/msg/Odometry",
    "/goal_pose": "geometry_msgs/msg/PoseStamped",
}


@pytest.fixture(scope="module")
def planner() -> LocalClient:
    return LocalClient.of()


class Recorded(Rehearsal):
    """A robot whose messages are written to a bag."""

    def record(self, bag: Path, seconds: float, *, storage: StoragePlugin) -> None:
        with Writer(bag, version=9, storage_plugin=storage) as writer:
            connections = {
                topic: writer.add_connection(topic, kind, typestore=STORE)
                for topic, kind in TYPES.items()
            }

            def written(topic: str, read: Callable[..., None]) -> Callable[..., None]:
                def both(message: Any, **options: Any) -> None:
                    stamp = round(1e9 * self.clock.now)
                    writer.write(connections[topic], stamp, serialize_message(message))
                    read(message, **options)

                return both

            inputs = self.inputs
            inputs.on_map = written("/map", inputs.on_map)
            inputs.on_odometry = written("/odom", inputs.on_odometry)
            inputs.on_goal = written("/goal_pose", inputs.on_goal)
            self.go(4.0, 0.0)
            self.run(seconds)


@pytest.mark.parametrize("storage", StoragePlugin)
def test_a_drive_is_replayed(planner: LocalClient, tmp_path: Path, storage: StoragePlugin) -> None:
    robot = Recorded(Switched(planner.plan_request))
    robot.record(tmp_path / "bag", 2.0, storage=storage)

    summary = replay(tmp_path / "bag", tmp_path / "out", Settings.of(), planner)

    driver = Driver(Settings.of(), planner, executor=AtOnce())
    row = figures(decision for _, decision in decisions(tmp_path / "bag", driver))
    assert (row["ticks"], row["plans"]) == (summary.ticks, summary.plans)
    assert (row["safe"], row["braked"]) == (1.0, 1 / 40)
    assert row["elsewhere"] == 0.0
    assert 0.0 < float(row["shift m"] or 0.0) < 0.2
    assert summary.ticks == 40
    assert 8 <= summary.plans <= 40
    assert summary.safe_share == 1.0
    assert summary.braking == {"service": 1}  # before the first answer
    with AnyReader([tmp_path / "out"]) as reader:
        read = [
            (each.topic, reader.deserialize(data, each.msgtype))
            for each, _, data in reader.messages()
        ]
        digests = {each.msgtype: each.digest for each in reader.connections}
    commands: list[Any] = [message for topic, message in read if topic == "/replay/cmd_vel"]
    plans: list[Any] = [message for topic, message in read if topic == "/replay/plan"]
    assert len(commands) == summary.ticks
    assert commands[-1].twist.linear.x > 0.5
    assert len(plans) == summary.plans
    assert plans[-1].poses[-1].pose.position.x == pytest.approx(4.0, abs=0.1)
    assert all(STORE.hash_rihs01(kind) == digest for kind, digest in digests.items())


def test_another_library_reads_the_file(planner: LocalClient, tmp_path: Path) -> None:
    decoders = pytest.importorskip("mcap_ros2.decoder", reason="mcap-ros2-support")
    readers = pytest.importorskip("mcap.reader", reason="mcap")
    robot = Recorded(Switched(planner.plan_request))
    robot.record(tmp_path / "bag", 0.5, storage=StoragePlugin.MCAP)
    replay(tmp_path / "bag", tmp_path / "out", Settings.of(), planner)

    (file,) = (tmp_path / "out").glob("*.mcap")
    with file.open("rb") as stream:
        reader = readers.make_reader(stream, decoder_factories=[decoders.DecoderFactory()])
        topics = [channel.topic for _, channel, _, _ in reader.iter_decoded_messages()]

    assert topics.count("/replay/cmd_vel") == 10


def test_a_bag_that_is_none_is_named(planner: LocalClient, tmp_path: Path) -> None:
    with pytest.raises(BagError, match="nowhere: expected a rosbag2 folder"):
        replay(tmp_path / "nowhere", tmp_path / "out", Settings.of(), planner)


def test_a_bag_without_the_topics_is_named(planner: LocalClient, tmp_path: Path) -> None:
    robot = Recorded(Switched(planner.plan_request))
    robot.record(tmp_path / "bag", 0.1, storage=StoragePlugin.MCAP)
    settings = Settings.of({"topics.odometry": "base/odom"})

    with pytest.raises(BagError, match="expected odometry on 'base/odom'"):
        replay(tmp_path / "bag", tmp_path / "out", settings, planner)


def test_a_parameter_file_that_is_none_is_named(tmp_path: Path) -> None:
    from anchorflow_cli.replay import read_parameters

    (tmp_path / "robot.yaml").write_text("robot.radius: 0.3\n")

    with pytest.raises(InvalidRequest, match=r"robot\.yaml: expected a file of ROS parameters"):
        read_parameters(tmp_path / "robot.yaml")
