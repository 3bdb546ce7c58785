"""Start the node with its parameters: `ros2 launch anchorflow_ros anchorflow.launch.py`."""

# launch and launch_ros are a robot's own: they have no wheels.
# pyright: reportMissingImports=false, reportAttributeAccessIssue=false

from __future__ import annotations

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    """Return the node, whose parameters, namespace and clock are arguments."""
    share = Path(get_package_share_directory("anchorflow_ros"))
    defaults = {
        "params_file": str(share / "config" / "anchorflow.yaml"),
        "namespace": "",
        "use_sim_time": "false",
    }
    node = Node(
        package="anchorflow_ros",
        executable="node",
        name="anchorflow",
        namespace=LaunchConfiguration("namespace"),
        parameters=[
            LaunchConfiguration("params_file"),
            {"use_sim_time": LaunchConfiguration("use_sim_time")},
        ],
        output="screen",
    )
    arguments = [
        DeclareLaunchArgument(name, default_value=value) for name, value in defaults.items()
    ]
    return LaunchDescription([*arguments, node])
