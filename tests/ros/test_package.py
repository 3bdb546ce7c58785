"""What colcon builds and the page says: package, parameter file and parameters agree."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml

from anchorflow_ros.parameters import PARAMETERS, Settings

ROS = Path(__file__).parents[2] / "ros"
PAGE = (ROS.parent / "docs" / "ros2.md").read_text()


def shown(default: Any) -> str:
    """Return a default as the page writes it."""
    if default in ([""], ""):
        return "none" if default else "empty"
    if isinstance(default, bool):
        return str(default).lower()
    return f"`{default}`" if isinstance(default, str) else f"{default:g}"


def test_the_parameter_file_is_valid() -> None:
    file = yaml.safe_load((ROS / "config" / "anchorflow.yaml").read_text())

    settings = Settings.of(file["/**"]["ros__parameters"])

    assert settings["service"] == "http://127.0.0.1:8000"
    assert settings.meaning.window_m == 12.0


def test_the_page_lists_every_parameter_and_topic() -> None:
    for name, (default, text) in PARAMETERS.items():
        if name.startswith("topics."):
            assert f"| `{default}` | " in PAGE, name
        else:
            assert f"| `{name}` | {shown(default)} | {text} |\n" in PAGE


def test_the_package_depends_on_what_it_imports() -> None:
    package = ElementTree.parse(ROS / "package.xml").getroot()
    depends = {each.text for each in package.findall("exec_depend")}

    text = "\n".join(path.read_text() for path in (ROS / "anchorflow_ros").glob("*.py"))
    imported = {
        line.split()[1].partition(".")[0]
        for line in text.splitlines()
        if (line.startswith("from ") and ".msg import" in line) or ".srv import" in line
    }
    assert imported - {"rosgraph_msgs"} <= depends  # the simulator's own
    assert package.findtext("name") == "anchorflow_ros"


def test_the_folder_installs_as_a_package_of_ros(tmp_path: Path) -> None:
    """As colcon's ament_python does, by the folder's own setup.py."""
    pytest.importorskip("setuptools")
    for name in ("build", "dist"):
        (tmp_path / name).mkdir()
    command = [sys.executable, "setup.py", "-q", "egg_info", "--egg-base", str(tmp_path)]
    command += ["build", "--build-base", str(tmp_path / "build")]
    command += ["install", "--root", str(tmp_path / "root"), "--single-version-externally-managed"]

    done = subprocess.run(
        [*command, "--record", str(tmp_path / "record")],
        cwd=ROS,
        check=False,
        capture_output=True,
        text=True,
    )

    assert done.returncode == 0, done.stderr
    installed = (tmp_path / "record").read_text()
    for path in (
        "share/ament_index/resource_index/packages/anchorflow_ros",
        "share/anchorflow_ros/package.xml",
        "share/anchorflow_ros/launch/anchorflow.launch.py",
        "share/anchorflow_ros/config/anchorflow.yaml",
        "lib/anchorflow_ros/node",
        "anchorflow_ros/node.py",
    ):
        assert path in installed, path
