"""`anchorflow data COMMAND`: imports the module of one command and runs it."""

from __future__ import annotations

from anchorflow_cli.lazy_group import LazyCommand, lazy_group
from anchorflow_cli.options import command_app

COMMANDS = {
    "make": LazyCommand("data_scenes:make", "Draw random scenes and let the expert solve them."),
    "import": LazyCommand("data_scenes:import_file", "Turn your own trajectories into a dataset."),
    "synthetic": LazyCommand("data_scenes:synthetic", "Draw smooth random trajectories."),
    "inspect": LazyCommand("data_scenes:inspect", "Print shapes and ranges; draw some scenes."),
    "from-poses": LazyCommand("data_scenes:from_poses", "Cut trajectories from recorded poses."),
    "drive": LazyCommand("data_driving:drive", "Simulate traffic with SUMO into driving logs."),
    "import-log": LazyCommand("data_driving:import_log", "Turn a recording into a driving log."),
    "frames": LazyCommand("data_driving:frames", "Draw what a bundle is asked along a drive."),
    "anchors": LazyCommand("data_driving:anchors", "Cluster examples into anchors; score them."),
    "sensors": LazyCommand("data_driving:sensors", "Draw the camera and LiDAR of every window."),
    "crossings": LazyCommand("data_pairs:crossings", "Draw crossings that a house hides."),
    "verify": LazyCommand("data_pairs:verify", "Say what a cooperative recording lacks."),
    "descriptions": LazyCommand("data_pairs:descriptions", "Describe pictures by a Florence-2."),
    "pairs": LazyCommand("data_pairs:pairs", "Make pairs of pictures, prompts and waypoints."),
}

app = command_app()


@app.callback(cls=lazy_group(COMMANDS, who="anchorflow data"), no_args_is_help=True)
def data() -> None:
    """Make datasets to train on, import your own, look into them."""
