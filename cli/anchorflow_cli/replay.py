"""`anchorflow replay`: plan at every tick of a recorded bag."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
import yaml
from rich.console import Console

from anchorflow_cli.options import command_app
from anchorflow_client.errors import InvalidRequest
from anchorflow_ros.parameters import Settings
from anchorflow_ros.replay import replay as replay_bag
from anchorflow_ros.services import client_of

app = command_app()


@app.command()
def replay(
    bag: Annotated[Path, typer.Argument(help="A rosbag2 folder or an .mcap file.")],
    out: Annotated[Path, typer.Argument(help="Folder to write, with an .mcap file.")],
    *,
    params: Annotated[
        Path | None, typer.Option(help="Parameter file of the node, for topics, robot and map.")
    ] = None,
) -> None:
    """Write the plans, commands and diagnostics that the ROS 2 node has for a bag's messages."""
    settings = Settings.of(None if params is None else read_parameters(params))
    with client_of(settings) as client:
        summary = replay_bag(bag, out, settings, client)
    Console(markup=False, soft_wrap=True).print(str(summary))


def read_parameters(path: Path) -> dict[str, Any]:
    """Return the parameters of a ROS parameter file. Raises `InvalidRequest` if it is none."""
    try:
        (node,) = yaml.safe_load(path.read_text(encoding="utf-8")).values()
        return dict(node["ros__parameters"])
    except (OSError, ValueError, KeyError, TypeError, AttributeError, yaml.YAMLError) as error:
        wanted = "a file of ROS parameters for one node"
        raise InvalidRequest(f"{path}: expected {wanted}: {error!r}", "--params") from error
