"""A simulated robot and the node, each in a process of its own, over Fast DDS."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ros_maps import write_map

from anchorflow_benchmarks.programs import Program, free_port, serve_command

pytest.importorskip("rclpy", reason="ROS 2 is not installed: pip install 'anchorflow[ros]'")

SPEED = 0.5
"""Simulated seconds in one of real time, so that a busy machine keeps up."""
NODE = (
    *("use_sim_time:=true", "goal.beyond_map:=approach", "map.timeout_s:=1.0"),
    *("service.silence_s:=0.5", "clock.stands_s:=5.0"),
)


@contextmanager
def ros_process(folder: Path, *command: str) -> Iterator[subprocess.Popen[str]]:
    """Run a module in a ROS domain of its own; its output is a file of the folder."""
    domain = str(100 + os.getpid() % 100)
    environment = os.environ | {
        "ROS_DOMAIN_ID": domain,
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_LOG_DIR": str(folder),
    }
    output = folder / f"{command[0]}.log"
    with output.open("w") as file:
        process = subprocess.Popen(
            [sys.executable, "-m", *command], env=environment, stdout=file, stderr=file, text=True
        )
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(20.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def node(folder: Path, *parameters: str) -> Any:
    given = [part for each in (*NODE, *parameters) for part in ("-p", each)]
    return ros_process(folder, "anchorflow_ros.node", "--ros-args", *given)


def simulator(folder: Path, *options: str) -> Any:
    speed = ("--speed", str(SPEED))
    return ros_process(folder, "anchorflow_ros.simulator", *speed, *options)


def result(folder: Path) -> dict[str, Any]:
    lines = (folder / "anchorflow_ros.simulator.log").read_text().splitlines()
    said = (folder / "anchorflow_ros.node.log").read_text()
    told = [line for line in lines if line.startswith("{")]  # rclpy may complain as it ends
    assert told, said
    return json.loads(told[-1]) | {"node": said}


def logged(folder: Path, words: str, limit_s: float = 60.0) -> float:
    """Wait for words in the node's log; return the s at which ROS logged them."""
    end = time.monotonic() + limit_s
    path = folder / "anchorflow_ros.node.log"
    while time.monotonic() < end:
        for line in path.read_text().splitlines() if path.exists() else ():
            if words in line and (stamp := re.search(r"\[(\d+\.\d+)\]", line)):
                return float(stamp[1])
        time.sleep(0.02)
    raise AssertionError(f"expected {words!r} in the log: {path.read_text()}")


def under_way(folder: Path) -> None:
    """Wait until the robot has had plans for some seconds."""
    logged(folder, "service: no answer has come")
    time.sleep(4.0)


def room(folder: Path) -> Path:
    """Write a room of 9 m with a post on the way through it."""
    grey = np.full((50, 90), 254, np.uint8)
    grey[[0, -1]] = grey[:, [0, -1]] = grey[22:26, 50:54] = 0
    return write_map(folder, grey)


def test_a_robot_with_lidar_arrives_and_brakes_while_its_service_is_away(tmp_path: Path) -> None:
    service = Program("service", serve_command("--port", str(free_port())), says=" at ")
    service.start()
    try:
        url = f"service:={service.url}"
        ends = ("--start", "1.2", "2.5", "0", "--goal", "7.7", "2.5")
        course = ("--map", str(room(tmp_path)), *ends, "--limit-s", "120")
        with node(tmp_path, url), simulator(tmp_path, *course) as robot:
            under_way(tmp_path)
            service.kill()
            logged(tmp_path, "service: no answer for ")
            assert robot.poll() is None
            service.start()
            robot.wait(240.0)
    finally:
        service.stop()

    run = result(tmp_path)
    assert run["end"] == "goal", run
    assert run["clearance_m"] > 0.0
    assert run["length_m"] > 6.0
    assert run["node"].index("no answer for ") < run["node"].index("goal: arrived")
