"""`anchorflow data import-log`: driving logs of other layouts."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from anchorflow_driving.importers.commonroad import import_commonroad
from anchorflow_driving.log import write_log


def import_log(
    file: Annotated[Path, typer.Argument(help="A CommonRoad scenario, .xml (2020a).")],
    *,
    out: Annotated[Path, typer.Option(help="Log to write, .npz.")],
) -> None:
    """Turn a recorded scenario into a driving log with its windows."""
    log, counts = import_commonroad(file)
    write_log(log, out)
    windows = counts.pop("windows", 0)
    tracks, frames = log.track_state.shape[:2]
    typer.echo(f"{out}: {tracks} tracks, {frames} frames, {windows} windows")
    for reason, count in sorted(counts.items()):
        typer.echo(f"{reason}: {count}")
