"""`anchorflow bench drive`: drivers on recorded logs, open loop."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from anchorflow_benchmarks.driving.open_loop import (
    ENTRIES,
    drive_tables,
    judge_drivers,
    named_drivers,
    write_plans,
)
from anchorflow_benchmarks.driving.score_time import score_time_table
from anchorflow_cli.bench_options import RESULTS, OutOption
from anchorflow_cli.bench_output import progress, report, say
from anchorflow_driving.log import read_logs


def drive(
    *,
    logs: Annotated[Path, typer.Option(help="Folder of driving logs (*.npz).")],
    drivers: Annotated[
        str, typer.Option(metavar="A,B", help="Who drives.", show_default="all")
    ] = ",".join(ENTRIES),
    plans: Annotated[
        Path | None,
        typer.Option(help="Folder that plans_*.npz are written to.", show_default="that of --out"),
    ] = None,
    out: OutOption = RESULTS,
) -> None:
    """Score rule-based drivers on recorded logs with the PDM score; tables and plans."""
    found, chosen = read_logs(logs), named_drivers(drivers.split(","))
    windows = sum(log.windows for log in found)
    with progress("driving", windows) as advance:
        judged = judge_drivers(chosen, found, progress=advance)
    about = {"logs": f"{logs.name}: {len(found)} files, {windows} windows"}
    report("Drive", about, [*drive_tables(judged), score_time_table(found)], out)
    for path in write_plans(judged, plans or out):
        say(str(path))
