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
    RecordOption,
    SamplersOption,
    ThreadsOption,
)
from anchorflow_cli.bench_output import progress, record, report, say
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
    recorded: RecordOption = False,
    out: OutOption = RESULTS,
) -> None:
    """Score drivers and bundles on recorded logs with the PDM score; tables and plans."""
    found = read_logs(logs)
    chosen = {} if drivers == "none" else named_drivers(drivers.split(","))
    asked = samplers.split(",")
    ours = open_drivers(bundle or [], num=num, samplers=asked, threads=threads)
    for driver in ours:
        ways = (driver, driver.along_route()) if along_route else (driver,)
        seeded = [way.seeded(seed) for way in ways for seed in seeds or [0]]
        chosen |= {each.name: Entry(each) for each in seeded}
    windows = sum(log.windows for log in found)
    with progress("driving", windows) as advance:
        judged = judge_drivers(chosen, found, progress=advance)
    about = {"logs": f"{logs.name}: {len(found)} files, {windows} windows"}
    tables = drive_tables(judged)
    report("Drive", about, [*tables, score_time_table(found)], out)
    if recorded:
        firsts = ours[:: len(asked)]
        names = [driver.seeded((seeds or [0])[0]).name for driver in firsts]
        record(zip(names, bundle or [], strict=True), about, tables[0])
    for path in write_plans(judged, plans or out):
        say(str(path))
