"""`anchorflow data …` of driving: simulate, import, draw and cluster driving logs."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.progress import Progress, track as with_bar

from anchorflow_cli.data_pairs import counted
from anchorflow_cli.extras import needs_extra
from anchorflow_cli.options import file_option, folder_option
from anchorflow_driving.drive_file import drive_file, windows_on_the_way
from anchorflow_driving.errors import place_to_write
from anchorflow_driving.importers import Layout, layout_of
from anchorflow_driving.importers.commonroad import import_commonroad
from anchorflow_driving.importers.navsim import import_navsim
from anchorflow_driving.importers.nuscenes import import_nuscenes
from anchorflow_driving.log import DrivingLog, open_logs, read_log, write_log
from anchorflow_driving.recorded_sensors import read_sensors
from anchorflow_driving.simulation import LogConfig
from anchorflow_training.atomic_write import writing
from anchorflow_training.driving.anchors import anchor_scores, examples_of, trajectory_anchors
from anchorflow_training.driving.driving_run import SightRunConfig
from anchorflow_training.driving.sensor_windows import SensorSizes, open_sensor_windows
from anchorflow_training.planners import training_of
from anchorflow_training.settings import ConfigError, layers
from anchorflow_trajectory.threads import usable_cores

COOPERATIVE = "cooperative-vehicle-infrastructure"
SCENES = (Layout.NUSCENES, Layout.NAVSIM)

LogsArgument = Annotated[Path, typer.Argument(metavar="LOGS", help="Folder of driving logs.")]


def drive(
    *,
    out: Annotated[Path, folder_option("Folder to write.")],
    logs: Annotated[int, typer.Option(min=1, help="How many.")] = 500,
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same bytes.")] = LogConfig.seed,
    seconds: Annotated[
        float, typer.Option(min=8.0, help="Recorded in each log.")
    ] = LogConfig.seconds,
    windows: Annotated[int, typer.Option(min=1, help="At most in each log.")] = LogConfig.windows,
    left_hand: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Share of logs with left-hand traffic.")
    ] = LogConfig.left_hand,
    deviating: Annotated[
        float,
        typer.Option(min=0.0, max=1.0, help="Share of logs whose windows begin off their lines."),
    ] = LogConfig.deviating,
    arterial: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Share of logs on long, fast streets.")
    ] = LogConfig.arterial,
    speed_limits: Annotated[
        bool,
        typer.Option(help="Write the lanes' limits; unknown ones, as of recordings, are 15 m/s."),
    ] = LogConfig.speed_limits,
    workers: Annotated[int, typer.Option(min=1, help="Processes.")] = usable_cores(),
    v2x: Annotated[
        bool,
        typer.Option("--v2x", help="Draw car and roadside cameras too, laid out as DAIR-V2X."),
    ] = False,
) -> None:
    """Simulate traffic with SUMO and write driving logs of it."""
    with needs_extra("driving", who="anchorflow data drive"):
        from anchorflow_driving.simulation.make_logs import make_logs
    config = LogConfig(
        seed=seed,
        seconds=seconds,
        windows=windows,
        left_hand=left_hand,
        deviating=deviating,
        arterial=arterial,
        speed_limits=speed_limits,
    )
    with Progress() as bar:
        task = bar.add_task("logs", total=logs)
        summary = make_logs(
            out, config, logs=logs, workers=workers, progress=lambda n: bar.advance(task, n)
        )
    turning = summary["turning"] / max(summary["windows"], 1)
    typer.echo(f"{out}: {logs} logs, {summary['windows']} windows, {turning:.0%} of them turning")
    for what in ("dropped", "redrawn"):
        told = ", ".join(f"{count} {reason}" for reason, count in summary[what].items())
        typer.echo(f"{what}: {told or 'none'}")
    if v2x:
        _draw_both_cameras(out)


def _draw_both_cameras(out: Path) -> None:
    """A cooperative recording of the logs of a folder, inside it."""
    from anchorflow_driving.cooperative.from_logs import log_drives
    from anchorflow_driving.cooperative.layout import write_recording
    from anchorflow_driving.sensors.rendering import Renderer

    paths = sorted(out.glob("*.npz"))
    folder = out / COOPERATIVE
    renderer = Renderer()
    with Progress() as bar:
        read = (read_log(path) for path in bar.track(paths, description="pictures"))
        pairs = write_recording(folder, log_drives(read, renderer))
    typer.echo(f"{folder}: {pairs} pairs")


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
    sensors: Annotated[
        Path | None,
        typer.Option(
            exists=True,
            file_okay=False,
            help="nuScenes, NAVSIM: folder of the recorded pictures and sweeps, to use them.",
        ),
    ] = None,
    as_recorded: Annotated[
        bool,
        typer.Option("--as-recorded", help="Stitch pictures without undoing lens and direction."),
    ] = False,
) -> None:
    """Turn a recording into a driving log with its windows."""
    layout = layout or layout_of(file)
    if scene is not None and layout not in SCENES:
        raise typer.BadParameter(f"--scene: a recording of {layout.value} holds one scene")
    if layout is not Layout.NAVSIM and (map_file is not None or unpickle):
        raise typer.BadParameter(f"--map and --unpickle: for navsim, found {layout.value}")
    if layout not in SCENES and sensors is not None:
        raise typer.BadParameter(f"--sensors: for nuscenes and navsim, found {layout.value}")
    if as_recorded and sensors is None:
        raise typer.BadParameter("--as-recorded: expected --sensors too, found none")
    seen = {"scene": scene, "sensors": sensors, "rectified": not as_recorded}
    log, counts = _imported(file, layout, map_file=map_file, unpickle=unpickle, **seen)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_log(log, out)
    windows = counts.pop("windows", 0)
    tracks, frames = log.track_state.shape[:2]
    typer.echo(f"{out}: {tracks} tracks, {frames} frames, {windows} windows")
    for reason, count in sorted(counts.items()):
        typer.echo(f"{reason}: {count}")


def _imported(
    file: Path, layout: Layout, *, map_file: Path | None, unpickle: bool, **options: Any
) -> tuple[DrivingLog, Counter[str]]:
    match layout:
        case Layout.COMMONROAD:
            return import_commonroad(file)
        case Layout.NUSCENES:
            return import_nuscenes(file, **options)
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
            return import_navsim(file, map_file=map_file, **options)


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
    with place_to_write(out):
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(text)
    times = [frame["time_s"] for frame in drive["frames"]]
    typer.echo(
        f"{out}: {len(times)} frames of track {drive['track']}, {times[0]:g} to {times[-1]:g} s, "
        f"{len(text) / 1e6:.1f} MB"
    )


def anchors(
    logs: LogsArgument,
    *,
    out: Annotated[Path, file_option("File to write (.npy), [K, 8, 3].")],
    count: Annotated[int, typer.Option(min=1, help="K.")] = 256,
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same bytes.")] = 0,
) -> None:
    """Cluster examples into anchors, and score each in every window.

    The PDM sub-scores are kept beside the logs; you can stop and restart it.
    """
    paths = open_logs(logs)
    futures = examples_of(paths)
    centres = trajectory_anchors(futures, count=count, seed=seed)
    with writing(out, ConfigError):
        out.parent.mkdir(parents=True, exist_ok=True)
        with out.open("wb") as file:
            np.save(file, centres)
    with counted("logs scored") as progress:
        table = anchor_scores(paths, centres, progress=progress)
    apart = np.linalg.norm(futures[:, None, :, :2] - centres[None, ..., :2], axis=-1).mean(-1)
    typer.echo(
        f"{out}: {count} anchors of {len(table)} windows, the nearest {apart.min(1).mean():.2f} m "
        "from its example"
    )


def sensors(
    logs: LogsArgument,
    *,
    config: Annotated[Path, typer.Option(help="Of the run that is to learn from them (YAML).")],
) -> None:
    """Read or simulate the camera and LiDAR of every window, and keep them beside the logs.

    You can stop and restart it; `anchorflow train` draws what is missing.
    """
    kind = training_of(None, config).config
    run = layers(kind, {}, config)
    if not isinstance(run, SightRunConfig) or run.sight is None:
        raise ConfigError(
            f"{config}: planner: expected one that sees by camera and LiDAR, got {kind.planner!r}"
        )
    sizes = SensorSizes.of(run.sight)
    paths = open_logs(logs)
    if any(read_sensors(path) is None for path in paths):
        with needs_extra("driving", who="anchorflow data sensors"):
            import moderngl  # noqa: F401 - so that its absence is one line
    with counted("logs drawn") as progress:
        windows = open_sensor_windows(paths, sizes, progress=progress)
    size = sum(map(len, windows.streams)) / 1e6
    typer.echo(f"{logs}: sensors of {len(windows)} windows, {size:.1f} MB")
