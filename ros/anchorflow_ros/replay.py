"""Plan at every tick of a recorded bag, and write what the node would have published.

    summary = replay(bag, out, Settings.of(parameters), client)

A bag is a rosbag2 folder or an .mcap file; rosbags reads and writes it, and no ROS is needed. Ticks
follow the stamps of the odometry. Answers count as arrived at the tick after their request.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from anchorflow_client.errors import AnchorFlowError
from anchorflow_client.planner import AnchorSource
from anchorflow_ros.driver import Decision, Driver
from anchorflow_ros.faults import ERROR, OK
from anchorflow_ros.frames import poses_of
from anchorflow_ros.inputs import seconds_and_nanoseconds, stamp_of
from anchorflow_ros.parameters import Settings
from anchorflow_ros.scene import SceneReader

STORE = get_typestore(Stores.ROS2_JAZZY)
WRITTEN = {
    "plan": "nav_msgs/msg/Path",
    "cmd_vel": "geometry_msgs/msg/TwistStamped",
    "diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}
"""Types by topic of the replay; the topics are below PREFIX."""
PREFIX = "/replay/"
PLAIN = {"string": "", "bool": False}


class BagError(AnchorFlowError):
    """A bag cannot be read, or has no topic to plan by."""


class AtOnce(Executor):
    """Runs each request when it is sent; its answer is there at the next tick."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except AnchorFlowError as error:
            future.set_exception(error)
        return future


@dataclass(frozen=True)
class Summary:
    """Figures of a replay."""

    ticks: int
    plans: int
    safe_share: float
    """Share of the plans that have a safe anchor."""
    plan_ms: float
    """Median time of a plan."""
    braking: Mapping[str, int]
    """Ticks by the part that made the robot brake."""

    def __str__(self) -> str:
        parts = ", ".join(f"{part} {count}" for part, count in self.braking.items()) or "never"
        return (
            f"{self.ticks} ticks, {self.plans} plans of {self.plan_ms:.0f} ms, "
            f"{self.safe_share:.2f} of them safe; braking: {parts}"
        )


def replay(bag: Path, out: Path, settings: Settings, client: AnchorSource) -> Summary:
    """Write the folder `out` with an .mcap file of a bag's plans, commands and diagnostics.

    Raises:
        BagError: the bag cannot be read, or `out` exists.
    """
    driver = Driver(settings, client, executor=AtOnce())
    record = _Record()
    if out.exists():
        raise BagError(f"{out}: expected a folder that is not there yet, got one that is")
    with Writer(out, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {
            topic: writer.add_connection(PREFIX + topic, kind, typestore=STORE)
            for topic, kind in WRITTEN.items()
        }
        for now, decision in decisions(bag, driver):
            for topic, message in record.messages(now, decision):
                data = STORE.serialize_cdr(message, WRITTEN[topic])
                writer.write(connections[topic], round(1e9 * now), data)
    driver.close()
    return record.summary()


def decisions(bag: Path, driver: Driver) -> Iterator[tuple[float, Decision]]:
    """Yield the time in s and the decision of each tick. Raises `BagError` as `replay`."""
    due: float | None = None
    for name, message in _messages(bag, driver.settings):
        if name != "odometry":
            _pass_on(driver.inputs, name, message, now=due or 0.0)
            continue
        now = stamp_of(message)
        driver.inputs.on_odometry(message)
        if due is None or now >= due or now < due - 1.0:
            due = now + driver.settings.tick_s
            yield now, driver.tick(now, steady=now)
    if due is None:
        topic = driver.settings["topics.odometry"]
        raise BagError(f"{bag}: expected odometry on {topic!r}, got none; see topics.odometry")


def _pass_on(inputs: SceneReader, name: str, message: Any, *, now: float) -> None:
    if name in ("map", "map_updates"):
        read = inputs.on_map if name == "map" else inputs.on_map_update
        read(message, now=now)
    else:
        getattr(inputs, f"on_{name}")(message)


def _messages(bag: Path, settings: Settings) -> Iterator[tuple[str, Any]]:
    """Yield the messages of the node's topics in their order, by the names of `topics.NAME`."""
    inputs = ("map", "map_updates", "odometry", "goal", "footprint", "tracks", "speed_limit")
    names = {"/" + settings[f"topics.{name}"].lstrip("/"): name for name in inputs}
    try:
        with AnyReader([bag], default_typestore=STORE) as reader:
            wanted = [each for each in reader.connections if each.topic in names]
            if not wanted:
                found = ", ".join(sorted(reader.topics)) or "none"
                raise BagError(f"{bag}: expected one of {', '.join(names)}, got {found}")
            for connection, _, data in reader.messages(connections=wanted):
                yield names[connection.topic], _read(reader, connection, data)
    except (AnyReaderError, FileNotFoundError) as error:
        raise BagError(f"{bag}: expected a rosbag2 folder or an .mcap file: {error}") from error


def _read(reader: AnyReader, connection: Connection, data: bytes) -> Any:
    return reader.deserialize(data, connection.msgtype)


class _Record:
    """Counts decisions, and makes their messages."""

    def __init__(self) -> None:
        self._ticks = 0
        self._answers: list[tuple[bool, float]] = []
        self._braking: Counter[str] = Counter()
        self._shown: str | None = None

    def messages(self, now: float, decision: Decision) -> Iterator[tuple[str, Any]]:
        """Yield topic and message."""
        self._ticks += 1
        if decision.braking and not decision.idle:
            self._braking[decision.faults[0].part] += 1
        header = header_of(now, decision.frame_id)
        forward, left, turn_rate = decision.twist.tolist()
        command = blank(WRITTEN["cmd_vel"], header=header)
        command.twist.linear.x, command.twist.linear.y = forward, left
        command.twist.angular.z = turn_rate
        yield "cmd_vel", command
        yield "diagnostics", _diagnostics(decision, header)
        plan = decision.plan
        if plan is None or plan.batch is None or plan.request_id == self._shown:
            return
        self._shown = plan.request_id
        self._answers.append((plan.reason is None, plan.batch.timing_ms.get("total", np.nan)))
        yield "plan", _path(decision)

    def summary(self) -> Summary:
        safe, times = zip(*self._answers, strict=True) if self._answers else ((), ())
        return Summary(
            ticks=self._ticks,
            plans=len(safe),
            safe_share=sum(safe) / max(len(safe), 1),
            plan_ms=float(np.median(times)) if times else np.nan,
            braking=dict(self._braking),
        )


def blank(kind: str, **fields: Any) -> Any:
    """Return a message whose other fields are 0, empty or false, as ROS's constructors do."""
    values = {name: _blank_field(spec) for name, spec in STORE.fielddefs[kind][1]}
    return STORE.types[kind](**values | fields)


def _blank_field(spec: Any) -> Any:
    kind, about = spec
    if kind.name == "BASE":
        base = about[0]
        return PLAIN.get(base, 0.0 if base.startswith("float") else 0)
    return blank(about) if kind.name == "NAME" else []


def header_of(seconds: float, frame_id: str) -> Any:
    sec, nanosec = seconds_and_nanoseconds(seconds)
    stamp = blank("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
    return blank("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id)


def _path(decision: Decision) -> Any:
    plan = decision.plan
    assert plan is not None
    assert plan.batch is not None
    best = plan.best or 0
    step_s = float(np.broadcast_to(plan.batch.dt, len(plan.batch.trajectories))[best])
    poses = []
    for row, (x, y, yaw) in enumerate(poses_of(plan.batch, best).tolist()):
        at = header_of(decision.starts_at + row * step_s, decision.frame_id)
        pose = blank("geometry_msgs/msg/PoseStamped", header=at)
        pose.pose.position.x, pose.pose.position.y = x, y
        pose.pose.orientation.z = float(np.sin(0.5 * yaw))
        pose.pose.orientation.w = float(np.cos(0.5 * yaw))
        poses.append(pose)
    header = header_of(decision.starts_at, decision.frame_id)
    return blank(WRITTEN["plan"], header=header, poses=poses)


def _diagnostics(decision: Decision, header: Any) -> Any:
    kind = "diagnostic_msgs/msg/DiagnosticStatus"
    statuses = [
        blank(kind, name=f"anchorflow: {each.part}", level=each.level, message=each.text)
        for each in decision.faults
    ] or [blank(kind, name="anchorflow", level=OK, message="driving")]
    assert all(OK <= status.level <= ERROR for status in statuses)
    return blank(WRITTEN["diagnostics"], header=header, status=statuses)
