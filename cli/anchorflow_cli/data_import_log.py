"""`anchorflow data import-log`: driving logs of other layouts."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Annotated

import typer

from anchorflow_cli.extras import needs_extra
from anchorflow_cli.options import file_option
from anchorflow_driving.importers import Layout, layout_of
from anchorflow_driving.importers.commonroad import import_commonroad
from anchorflow_driving.importers.navsim import import_navsim
from anchorflow_driving.importers.nuscenes import import_nuscenes
from anchorflow_driving.log import DrivingLog, write_log

SCENES = (Layout.NUSCENES, Layout.NAVSIM)


def import_log(
    file: Annotated[
        Path,
        typer.Argument(
            help="CommonRoad .xml (2020a), nuScenes folder, Argoverse 2 scenario_*.parquet or its"
            " folder, NAVSIM .pkl."
        ),
    ],
    *,
    out: Annotated[Path, file_option("Log to write, .npz.")],
    layout: Annotated[
        Layout | None, typer.Option("--format", help="Where the name does not tell it.")
    ] = None,
    scene: Annotated[
        str | None, typer.Option(help="nuScenes: its name; NAVSIM: its scene_token.")
    ] = None,
    map_file: Annotated[
        Path | None, typer.Option("--map", help="NAVSIM: nuPlan's map.gpkg of the city.")
    ] = None,
    unpickle: Annotated[
        bool,
        typer.Option("--unpickle", help="NAVSIM: open a pickle; only plain data is read from it."),
    ] = False,
) -> None:
    """Turn a recording into a driving log with its windows."""
    layout = layout or layout_of(file)
    if scene is not None and layout not in SCENES:
        raise typer.BadParameter(f"--scene: a recording of {layout.value} holds one scene")
    if layout is not Layout.NAVSIM and (map_file is not None or unpickle):
        raise typer.BadParameter(f"--map and --unpickle: for navsim, found {layout.value}")
    log, counts = _imported(file, layout, scene=scene, map_file=map_file, unpickle=unpickle)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_log(log, out)
    windows = counts.pop("windows", 0)
    tracks, frames = log.track_state.shape[:2]
    typer.echo(f"{out}: {tracks} tracks, {frames} frames, {windows} windows")
    for reason, count in sorted(counts.items()):
        typer.echo(f"{reason}: {count}")


def _imported(
    file: Path, layout: Layout, *, scene: str | None, map_file: Path | None, unpickle: bool
) -> tuple[DrivingLog, Counter[str]]:
    match layout:
        case Layout.COMMONROAD:
            return import_commonroad(file)
        case Layout.NUSCENES:
            return import_nuscenes(file, scene=scene)
        case Layout.ARGOVERSE:
            with needs_extra("driving", who="anchorflow data import-log of Argoverse 2"):
                from anchorflow_driving.importers.argoverse import import_argoverse
            return import_argoverse(file)
        case Layout.NAVSIM:
            if not unpickle:
                raise typer.BadParameter(
                    f"{file} is a pickle: --unpickle opens it. Arrays, numbers, texts and"
                    " containers are read; nothing in it is run"
                )
            return import_navsim(file, map_file=map_file, scene=scene)
