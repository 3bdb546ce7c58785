"""`anchorflow data frames`: a drive that the page plays to a planner."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import track as with_bar

from anchorflow_cli.extras import needs_extra
from anchorflow_cli.options import file_option
from anchorflow_driving.drive_file import drive_file, windows_on_the_way
from anchorflow_driving.errors import LogError
from anchorflow_driving.log import read_log


def frames(
    log: Annotated[Path, typer.Argument(help="A driving log, .npz.")],
    *,
    bundle: Annotated[Path, typer.Option(help="Folder of the bundle that is to be asked.")],
    out: Annotated[Path, file_option("File to write, .json.")],
    track: Annotated[
        int | None,
        typer.Option(min=0, help="The vehicle to follow.", show_default="drives farthest"),
    ] = None,
    every: Annotated[float, typer.Option(help="From one frame to the next [s].")] = 0.5,
) -> None:
    """Draw what a bundle is asked along one vehicle's way, for the page to play."""
    with needs_extra("service", who="anchorflow data frames"):
        from anchorflow_service.bundle import load_bundle
    card = load_bundle(bundle).card
    followed = windows_on_the_way(read_log(log), track=track, every_s=every)
    drive, drawn = drive_file(followed, card.inputs, of=card.name)
    with needs_extra("driving", who="anchorflow data frames"):
        drive["frames"] = list(with_bar(drawn, "frames", total=followed.windows))
    text = json.dumps(drive, separators=(",", ":"), allow_nan=False)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(text)
    except OSError as error:
        raise LogError(out, "file", expected="a place to write", found=str(error)) from error
    times = [frame["time_s"] for frame in drive["frames"]]
    typer.echo(
        f"{out}: {len(times)} frames of track {drive['track']}, {times[0]:g} to {times[-1]:g} s, "
        f"{len(text) / 1e6:.1f} MB"
    )
