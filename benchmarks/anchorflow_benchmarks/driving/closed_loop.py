"""Let drivers and bundles drive in SUMO's traffic, closed loop: the others react.

Run by `anchorflow bench drive-closed-loop`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import fmean, median
from typing import Annotated

import typer

from anchorflow_benchmarks import options
from anchorflow_benchmarks.driving.open_loop import named_drivers, open_drivers, ways_to_drive
from anchorflow_benchmarks.report import ResultTable, Row, progress, report
from anchorflow_cli.options import folder_option
from anchorflow_driving.drivers import DRIVERS, Driver
from anchorflow_driving.late_driver import late_drivers
from anchorflow_driving.log import DrivingLog, write_log
from anchorflow_driving.simulation.closed_loop import ClosedLoopConfig, RouteResult, drive_route

# There is no record.
BASELINES: dict[str, Driver] = {name: DRIVERS[name] for name in DRIVERS if name != "human"}
NOTE = (
    "A route ends with the first of: its length; a collision at fault, as the PDM score has it; a"
    " corner off the road; 10 m beside the route; its time. progress: share of the routes that was"
    " passed; km: driven; comfort: share of all stretches of 4 s within the PDM score's bounds; s:"
    " median of the completed routes; ms: median time of a plan. Every driver starts from the same"
    " traffic. along_route: the same bundle, told its route where its card takes"
    " one; of what others propose, the best that ends within 2 m of the route, or of all where none"
    " that moves does."
)


def drive_routes(
    drivers: Mapping[str, Driver],
    config: ClosedLoopConfig,
    *,
    routes: int,
    keep: Path | None = None,
    progress: Callable[[int], None] = lambda _: None,
) -> dict[str, list[RouteResult]]:
    """Let every driver drive routes 0, 1, …; `progress` gets 1 per route.

    keep: folder that every drive is written to as a log
    """
    driven: dict[str, list[RouteResult]] = {name: [] for name in drivers}
    for index in range(routes):
        for name, driver in drivers.items():
            keeping = None if keep is None else partial(_keep, keep, name)
            driven[name].append(drive_route(driver, config, index, keep=keeping))
            progress(1)
    return driven


def _keep(folder: Path, driver: str, log: DrivingLog) -> None:
    write_log(log, folder / f"{driver}-{log.name}.npz")


def routes_table(
    driven: Mapping[str, Sequence[RouteResult]], config: ClosedLoopConfig
) -> ResultTable:
    count = max(map(len, driven.values()), default=0)
    rows = [_row(name, results, config.length_m) for name, results in driven.items()]
    return ResultTable(f"{count} routes of {config.length_m:g} m", rows, NOTE)


def _row(name: str, results: Sequence[RouteResult], length_m: float) -> Row:
    ends = Counter(result.outcome for result in results)
    km = sum(result.driven_m for result in results) / 1e3
    finished = [result.seconds for result in results if result.outcome == "completed"]
    comfort = [comfortable for result in results for comfortable in result.comfortable]
    return {
        "driver": name,
        "completed": ends["completed"] / len(results),
        "progress": fmean(min(result.progress_m / length_m, 1.0) for result in results),
        "collisions/km": ends["collision"] / km if km else None,
        "off road/km": ends["off road"] / km if km else None,
        "off route": ends["off route"],
        "out of time": ends["time"],
        "km": km,
        "comfort": fmean(comfort) if comfort else None,
        "s": median(finished) if finished else None,
        "ms": median(ms for result in results for ms in result.plan_ms),
    }


def drive_closed_loop(
    *,
    drivers: Annotated[
        str,
        typer.Option(
            metavar="A,B", help="Who drives; none for none.", show_default="the baselines"
        ),
    ] = ",".join(BASELINES),
    bundle: options.DrivingBundles = None,
    along_route: options.AlongRoute = False,
    foreseeing: options.Foreseeing = False,
    route_drives: options.RouteDrives = False,
    late_ms: options.Late = None,
    num: options.Num = 64,
    threads: options.Threads = None,
    routes: Annotated[int, typer.Option(min=1, help="How many, each on a net of its own.")] = 20,
    length: Annotated[float, typer.Option(min=50.0, help="Of a route [m].")] = 300.0,
    seconds: Annotated[float, typer.Option(min=5.0, help="Until a route is given up.")] = 90.0,
    seed: Annotated[int, typer.Option(min=0, help="Of nets and traffic.")] = 2000,
    keep: Annotated[
        Path | None,
        folder_option("Folder where every drive is kept as a log, to learn from."),
    ] = None,
    out: options.Out = options.RESULTS,
) -> None:
    """Let drivers and bundles drive in SUMO's traffic; a table of what happened."""
    chosen: dict[str, Driver] = named_drivers(options.comma_separated(drivers), BASELINES)
    ours = open_drivers(bundle or [], num=num, threads=threads)
    ways = ways_to_drive(
        ours, along_route=along_route, foreseeing=foreseeing, route_drives=route_drives
    )
    for each in ways:
        chosen[each.name] = each
    if keep is not None:
        keep.mkdir(parents=True, exist_ok=True)
    config = ClosedLoopConfig(seed=seed, length_m=length, seconds=seconds)
    driven: dict[str, list[RouteResult]] = {}
    delays = [1e-3 * ms for ms in late_ms or [0]]
    with progress("driving", routes * len(chosen) * len(delays)) as advance:
        for delay_s in delays:
            late = {
                each: driver
                for name, alone in chosen.items()
                for each, driver in late_drivers(alone, name, delay_s).items()
            }
            own = replace(config, delay_s=delay_s)
            driven |= drive_routes(late, own, routes=routes, keep=keep, progress=advance)
    about = {"traffic": f"SUMO, seed {seed}, right-hand, no traffic lights"}
    report("Drive closed loop", about, [routes_table(driven, config)], out)
