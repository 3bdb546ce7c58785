"""`anchorflow bench drive`: drivers and bundles on recorded logs, open loop."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from anchorflow_benchmarks.driving.bundle_driver import open_drivers
from anchorflow_benchmarks.driving.open_loop import (
    ENTRIES,
    Entry,
    drive_tables,
    judge_drivers,
    named_drivers,
    write_plans,
)
from anchorflow_benchmarks.driving.score_time import score_time_table
from anchorflow_benchmarks.samplers import CARD
from anchorflow_cli.bench_options import (
    RESULTS,
    AlongRouteOption,
    NumOption,
    OutOption,
    SamplersOption,
    ThreadsOption,
)
from anchorflow_cli.bench_output import progress, report, say
from anchorflow_cli.options import folder_option
from anchorflow_driving.log import read_logs


def drive(
    *,
    logs: Annotated[Path, typer.Option(help="Folder of driving logs (*.npz).")],
    drivers: Annotated[
        str, typer.Option(metavar="A,B", help="Who drives; none for none.", show_default="all")
    ] = ",".join(ENTRIES),
    bundle: Annotated[
        list[Path] | None,
        typer.Option("--bundle", help="Folder of a bundle that drives too; repeatable."),
    ] = None,
    along_route: AlongRouteOption = False,
    num: NumOption = 64,
    samplers: SamplersOption = CARD,
    seeds: Annotated[
        list[int] | None,
        typer.Option("--seed", help="Of a bundle's noise; repeatable.", show_default="0", min=0),
    ] = None,
    threads: ThreadsOption = None,
    plans: Annotated[
        Path | None,
        folder_option("Folder that plans_*.npz are written to.", show_default="that of --out"),
    ] = None,
    out: OutOption = RESULTS,
) -> None:
    """Score drivers and bundles on recorded logs with the PDM score; tables and plans."""
    found = read_logs(logs)
    chosen = {} if drivers == "none" else named_drivers(drivers.split(","))
    for driver in open_drivers(
        bundle or [], num=num, samplers=samplers.split(","), threads=threads
    ):
        ways = (driver, driver.along_route()) if along_route else (driver,)
        seeded = [way.seeded(seed) for way in ways for seed in seeds or [0]]
        chosen |= {each.name: Entry(each) for each in seeded}
    windows = sum(log.windows for log in found)
    with progress("driving", windows) as advance:
        judged = judge_drivers(chosen, found, progress=advance)
    about = {"logs": f"{logs.name}: {len(found)} files, {windows} windows"}
    report("Drive", about, [*drive_tables(judged), score_time_table(found)], out)
    for path in write_plans(judged, plans or out):
        say(str(path))
