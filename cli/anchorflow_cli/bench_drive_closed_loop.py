"""`anchorflow bench drive-closed-loop`: drivers among simulated others who react."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from anchorflow_benchmarks.driving.bundle_driver import open_drivers
from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_cli.bench_options import (
    RESULTS,
    AlongRouteOption,
    NumOption,
    OutOption,
    ThreadsOption,
)
from anchorflow_cli.bench_output import progress, report
from anchorflow_cli.extras import needs_extra
from anchorflow_cli.options import folder_option


def drive_closed_loop(
    *,
    drivers: Annotated[
        str,
        typer.Option(
            metavar="A,B", help="Who drives; none for none.", show_default="the baselines"
        ),
    ] = "",
    bundle: Annotated[
        list[Path] | None,
        typer.Option("--bundle", help="Folder of a bundle that drives too; repeatable."),
    ] = None,
    along_route: AlongRouteOption = False,
    num: NumOption = 64,
    threads: ThreadsOption = None,
    routes: Annotated[int, typer.Option(min=1, help="How many, each on a net of its own.")] = 20,
    length: Annotated[float, typer.Option(min=50.0, help="Of a route [m].")] = 300.0,
    seconds: Annotated[float, typer.Option(min=5.0, help="Until a route is given up.")] = 90.0,
    seed: Annotated[int, typer.Option(min=0, help="Of nets and traffic.")] = 2000,
    keep: Annotated[
        Path | None,
        folder_option("Folder where every drive is kept as a log, to learn from."),
    ] = None,
    out: OutOption = RESULTS,
) -> None:
    """Let drivers and bundles drive in SUMO's traffic; a table of what happened."""
    with needs_extra("driving", who="anchorflow bench drive-closed-loop"):
        from anchorflow_benchmarks.driving.closed_loop import (
            BASELINES,
            ClosedLoopConfig,
            baselines,
            drive_routes,
            routes_table,
        )
    names = [name for name in (drivers or ",".join(BASELINES)).split(",") if name != "none"]
    for name in names:
        if name not in BASELINES:
            raise BenchmarkError(f"expected drivers among {', '.join(BASELINES)}, got {name!r}")
    chosen = baselines(names)
    for driver in open_drivers(bundle or [], num=num, threads=threads):
        for each in (driver, driver.along_route()) if along_route else (driver,):
            chosen[each.name] = each
    if keep is not None:
        keep.mkdir(parents=True, exist_ok=True)
    config = ClosedLoopConfig(seed=seed, length_m=length, seconds=seconds)
    with progress("driving", routes * len(chosen)) as advance:
        driven = drive_routes(chosen, config, routes=routes, keep=keep, progress=advance)
    about = {"traffic": f"SUMO, seed {seed}, right-hand, no traffic lights"}
    report("Drive closed loop", about, [routes_table(driven, config)], out)
