"""`anchorflow bench drive-closed-loop`: drivers among simulated others who react."""

from __future__ import annotations

from typing import Annotated

import typer

from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_cli.bench_options import RESULTS, OutOption
from anchorflow_cli.bench_output import progress, report
from anchorflow_cli.extras import needs_extra


def drive_closed_loop(
    *,
    drivers: Annotated[
        str, typer.Option(metavar="A,B", help="Who drives.", show_default="the baselines")
    ] = "",
    routes: Annotated[int, typer.Option(min=1, help="How many, each on a net of its own.")] = 20,
    length: Annotated[float, typer.Option(min=50.0, help="Of a route [m].")] = 300.0,
    seconds: Annotated[float, typer.Option(min=5.0, help="Until a route is given up.")] = 90.0,
    seed: Annotated[int, typer.Option(min=0, help="Of nets and traffic.")] = 2000,
    out: OutOption = RESULTS,
) -> None:
    """Let drivers drive in SUMO's traffic; a table of what happened."""
    with needs_extra("driving", who="anchorflow bench drive-closed-loop"):
        from anchorflow_benchmarks.driving.closed_loop import (
            BASELINES,
            ClosedLoopConfig,
            baselines,
            drive_routes,
            routes_table,
        )
    names = drivers.split(",") if drivers else BASELINES
    for name in names:
        if name not in BASELINES:
            raise BenchmarkError(f"expected drivers among {', '.join(BASELINES)}, got {name!r}")
    config = ClosedLoopConfig(seed=seed, length_m=length, seconds=seconds)
    with progress("driving", routes * len(names)) as advance:
        driven = drive_routes(baselines(names), config, routes=routes, progress=advance)
    about = {"traffic": f"SUMO, seed {seed}, right-hand, no traffic lights"}
    report("Drive closed loop", about, [routes_table(driven, config)], out)
