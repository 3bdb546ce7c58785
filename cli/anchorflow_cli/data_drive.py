"""`anchorflow data drive`: simulated driving logs, to train and judge driving planners on."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.progress import Progress

from anchorflow_cli.extras import needs_extra
from anchorflow_cli.options import folder_option
from anchorflow_driving.simulation import LogConfig
from anchorflow_trajectory.threads import usable_cores

COOPERATIVE = "cooperative-vehicle-infrastructure"


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
    from anchorflow_driving.log import read_log
    from anchorflow_driving.sensors.rendering import Renderer

    paths = sorted(out.glob("*.npz"))
    folder = out / COOPERATIVE
    renderer = Renderer()
    with Progress() as bar:
        read = (read_log(path) for path in bar.track(paths, description="pictures"))
        pairs = write_recording(folder, log_drives(read, renderer))
    typer.echo(f"{folder}: {pairs} pairs")
