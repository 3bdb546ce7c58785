"""Score drivers on every window of recorded logs, open loop: the traffic does not react.

`anchorflow bench drive` prints tables by source, command and log, and writes the plans.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import fmean, median
from time import perf_counter
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray
from scipy.stats import rankdata

from anchorflow_benchmarks import BenchmarkError, options
from anchorflow_benchmarks.planners import CARD, bundle_names, parse_sampler
from anchorflow_benchmarks.report import ResultTable, Row, progress, record, report, say
from anchorflow_cli.options import folder_option
from anchorflow_client.contract import OdeSpec
from anchorflow_driving.bundle_driver import BundleDriver, WindowProposals
from anchorflow_driving.drivers import (
    DENSE_TIMES,
    DRIVERS,
    PLAN_TIMES,
    WAYPOINT_TIMES,
    Driver,
    collides,
)
from anchorflow_driving.geometry import out_of_frame
from anchorflow_driving.late_driver import LateDriver, late_drivers
from anchorflow_driving.log import COMMANDS, FRAME_S, DrivingLog, read_logs
from anchorflow_driving.pdm import SUB_SCORES, PdmScorer
from anchorflow_driving.recorded_sensors import kinds_of
from anchorflow_driving.window import Scenes, Window
from anchorflow_service.bundle import load_bundle
from anchorflow_service.engine import Engine
from anchorflow_service.local import LocalClient

Array = NDArray[np.float64]

TOP_GOALS, NEAR_M = 5, 3.0
MOVING_M = 2.0  # m to the recorded end, from which a window counts as moving
GOAL_FIGURES = ("top 5", "top 5 by score", "off-road score")
NOTE = (
    "Shares and scores from 0 to 1, distances in m. against: driven in lanes that lead the other"
    " way; ADE and FDE over the 8 poses of 4 s; hit: share of plans whose box, as 45 waypoints and"
    " untracked, overlaps another within 4.5 s; ms: median time of a plan."
)
PROPOSALS_NOTE = (
    "oracle: the best PDMS of N proposals; minADE: m, of the nearest to the record; rank: Spearman"
    " correlation of score and PDMS where these differ; ms: medians, of drawing what the bundle is"
    " shown, of its flow and scores, and of a plan in all."
)
GOALS_NOTE = (
    f"Shares of the windows that move {MOVING_M:g} m whose recorded end lies within {NEAR_M:g} m of"
    f" one of {TOP_GOALS} goals: the first that trajectories are drawn to, and those with the"
    " highest scores; and the mean score of goals off the road."
)


@dataclass(frozen=True)
class Entry:
    """A driver, and the times of the poses it is judged at: 8, or all 40 that it plans."""

    driver: Driver | BundleDriver
    times: Array = field(default_factory=lambda: PLAN_TIMES)


# PDM-Closed plans 40 poses; its 8 poses compare with planners of 8.
ENTRIES = {
    **{name: Entry(driver) for name, driver in DRIVERS.items()},
    "idm_40_poses": Entry(DRIVERS["idm"], DENSE_TIMES),
}


@dataclass(frozen=True, eq=False)
class Judged:
    """One driver's plan of one window."""

    log: str
    window: int
    source: str
    command: str
    plan: Array  # [8, 3] or [40, 3]
    waypoints: Array | None  # [45, 2], of drivers that plan 4.5 s
    figures: Mapping[str, float]
    ms: float
    proposals: WindowProposals | None = None  # of a bundle


def open_drivers(
    folders: Sequence[Path], *, num: int, samplers: Sequence[str] = (CARD,), threads: int | None
) -> list[BundleDriver]:
    """Return a driver for each bundle and sampler, with names that a file name may hold.

    Raises `BundleError` if a bundle is broken; `SensorError` if a planner cannot drive logs;
    `BenchmarkError` if a bundle has no such sampler.
    """
    bundles = [load_bundle(folder) for folder in folders]
    drivers = []
    for bundle, name in zip(bundles, bundle_names(bundles), strict=True):
        safe_name = re.sub(r"[^\w.-]+", "_", name).strip("_")
        client = LocalClient(Engine(bundle, threads=threads))
        for text in samplers:
            sampler = None
            if isinstance(bundle.card.sampler, OdeSpec):
                spec = parse_sampler(text, bundle.card)
                sampler = {"method": spec.method, "schedule": list(spec.schedule)}
            elif text != CARD:
                raise BenchmarkError(f"{bundle.card.name}: expected sampler {CARD}, got {text!r}")
            label = safe_name if text == CARD else f"{safe_name}_{text.replace(':', '_')}"
            drivers.append(BundleDriver(client, bundle.card, num=num, name=label, sampler=sampler))
    return drivers


def ways_to_drive(
    drivers: Sequence[BundleDriver],
    *,
    along_route: bool,
    foreseeing: bool,
    guarded: bool = False,
    route_drives: bool = False,
) -> list[BundleDriver]:
    """Return each driver as it is, and as the options ask besides.

    Raises `BenchmarkError` if one is to foresee and no bundle predicts the others.
    """
    if foreseeing and not any(driver.predicts for driver in drivers):
        raise BenchmarkError("--foreseeing: expected a --bundle whose card has futures, got none")
    ways = []
    for driver in drivers:
        plain = [driver, driver.along_route()] if along_route else [driver]
        ways += plain + ([way.guarded() for way in plain] if guarded else [])
        ways += [way.foreseeing() for way in plain if foreseeing and way.predicts]
        ways += [driver.route_drives()] if route_drives and driver.has_route_drives else []
    return ways


def named_drivers(names: Sequence[str], among: Mapping[str, Any] = ENTRIES) -> dict[str, Any]:
    """Return rule-based drivers by name. Raises `BenchmarkError` if a name is unknown."""
    for name in names:
        if name not in among:
            raise BenchmarkError(f"expected drivers among {', '.join(among)}, got {name!r}")
    return {name: among[name] for name in names}


def _late(driver: Driver, name: str, late_ms: Sequence[int]) -> dict[str, Entry]:
    return {
        each: Entry(LateDriver(late, 1e-3 * ms))
        for ms in late_ms
        if ms
        for each, late in late_drivers(driver, name, 1e-3 * ms).items()
    }


def judge_drivers(
    drivers: Mapping[str, Entry],
    logs: Iterable[DrivingLog],
    *,
    progress: Callable[[int], None] = lambda _: None,
) -> dict[str, list[Judged]]:
    """Judge every driver's plan of every window; `progress` gets 1 per window."""
    judged: dict[str, list[Judged]] = {name: [] for name in drivers}
    for log in logs:
        for window in Scenes(log):
            for name, verdict in _judge_window(drivers, window).items():
                judged[name].append(verdict)
            progress(1)
    return judged


def drive_tables(judged: Mapping[str, Sequence[Judged]]) -> list[ResultTable]:
    """Return tables of all windows, by source, by command, of bundles, and the PDMS by log."""
    everything = next(iter(judged.values()), [])
    sources = sorted({verdict.source for verdict in everything})
    commands = [name for name in COMMANDS if any(v.command == name for v in everything)]
    groups: list[tuple[str, Callable[[Judged], bool]]] = [("All windows", lambda _: True)]
    groups += [(f"Source {name}", lambda v, name=name: v.source == name) for name in sources]
    groups += [(f"Command {name}", lambda v, name=name: v.command == name) for name in commands]
    tables = []
    for title, belongs in groups:
        count = sum(map(belongs, everything))
        rows = [_row(name, [v for v in all_ if belongs(v)]) for name, all_ in judged.items()]
        tables.append(ResultTable(f"{title} ({count})", rows, NOTE if not tables else ""))
    return [*tables, *bundle_tables(judged), _by_log(judged)]


def write_plans(judged: Mapping[str, Sequence[Judged]], folder: Path) -> list[Path]:
    """Write plans_DRIVER.npz of 8 poses and, for drivers that plan 4.5 s, waypoints_DRIVER.npz.

    Keys: log [W] file name without suffix, window [W], trajectories [W, 8, 3] or [W, 45, 2]; of
    bundles also proposals [W, N, 8, 3] and, if the bundle has scores, scores [W, N].

    Raises `BenchmarkError` if a file cannot be written.
    """
    written = []
    for name, verdicts in judged.items():
        plans = [v.plan for v in verdicts if len(v.plan) == len(PLAN_TIMES)]
        if plans:
            written.append(_write(folder / f"plans_{name}.npz", verdicts, plans))
        waypoints = [v.waypoints for v in verdicts if v.waypoints is not None]
        if waypoints:
            written.append(_write(folder / f"waypoints_{name}.npz", verdicts, waypoints))
    return written


def _judge_window(drivers: Mapping[str, Entry], window: Window) -> dict[str, Judged]:
    scorer, judged = PdmScorer(window), {}
    for name, entry in drivers.items():
        started, proposals = perf_counter(), None
        if isinstance(entry.driver, BundleDriver):
            proposals = entry.driver.propose(window)
            plan = proposals.trajectories[proposals.best]
        else:
            plan = entry.driver(window, entry.times)
        ms = 1e3 * (perf_counter() - started)
        motion = scorer.motion(plan[None])
        scores = scorer.judge(motion)
        waypoints = _waypoints(entry.driver, window)
        hit = float("nan") if waypoints is None else float(collides(window, waypoints))
        verdict = Judged(
            log=Path(window.log.path).stem,
            window=window.index,
            source=window.log.source,
            command=window.command_name,
            plan=plan,
            waypoints=waypoints,
            figures={
                **{n.upper(): float(getattr(scores, n)[0]) for n in (*SUB_SCORES, "pdms")},
                "against": float(scorer.metres_against(motion)[0]),
                **_distances(window, plan, entry.times),
                "hit": hit,
            },
            ms=ms,
        )
        if proposals:
            figures = proposal_figures(window, proposals, scorer)
            verdict = replace(verdict, figures={**verdict.figures, **figures}, proposals=proposals)
        judged[name] = verdict
    return judged


def proposal_figures(
    window: Window, proposals: WindowProposals, scorer: PdmScorer
) -> dict[str, float]:
    """Return oracle, minADE, rank, and GOAL_FIGURES if there are goals; NaN without a value."""
    pdms = scorer.score(proposals.trajectories).pdms
    driven = window.recorded(PLAN_TIMES)
    away = np.linalg.norm(proposals.trajectories[..., :2] - driven[:, :2], axis=-1)
    return {
        "oracle": float(pdms.max()),
        "minADE": float(away.mean(-1).min()),
        "rank": _rank(proposals.scores, pdms),
        **_goal_figures(window, proposals),
    }


def _rank(scores: Array | None, pdms: Array) -> float:
    if scores is None or np.ptp(pdms) == 0 or np.ptp(scores) == 0:
        return float("nan")
    return float(np.corrcoef(rankdata(scores), rankdata(pdms))[0, 1])


def _goal_figures(window: Window, proposals: WindowProposals) -> dict[str, float]:
    goals, scores = proposals.goals, proposals.goal_scores
    if goals is None or scores is None:
        return {}
    end = window.recorded(PLAN_TIMES)[-1, :2]
    near = np.linalg.norm(goals - end, axis=-1) < NEAR_M
    best = np.argsort(-scores, kind="stable")[:TOP_GOALS]
    moves = bool(np.linalg.norm(end) > MOVING_M)
    off_road = ~window.road.is_drivable(out_of_frame(goals, window.state.pose))
    return {
        "top 5": float(near[:TOP_GOALS].any()) if moves else float("nan"),
        "top 5 by score": float(near[best].any()) if moves else float("nan"),
        "off-road score": float(scores[off_road].mean()) if off_road.any() else float("nan"),
    }


def _waypoints(driver: Driver | BundleDriver, window: Window) -> Array | None:
    """Return [45, 2] of a driver that plans 4.5 s."""
    if isinstance(driver, BundleDriver | LateDriver):
        return None
    waypoints = driver(window, WAYPOINT_TIMES)[:, :2]
    return waypoints if np.isfinite(waypoints).all() else None


def _distances(window: Window, plan: Array, times: Array) -> dict[str, float]:
    at_plan_times = plan[np.searchsorted(times, PLAN_TIMES - FRAME_S / 2), :2]
    away = np.linalg.norm(at_plan_times - window.recorded(PLAN_TIMES)[:, :2], axis=-1)
    at = {f"L2 {second} s": float(away[2 * second - 1]) for second in (1, 2, 3, 4)}
    return {"ADE": float(away.mean()), "FDE": float(away[-1]), **at}


def _row(name: str, verdicts: Sequence[Judged]) -> Row:
    keys = [key for key in (verdicts[0].figures if verdicts else ()) if key not in GOAL_FIGURES]
    ms = median(v.ms for v in verdicts) if verdicts else None
    return {"driver": name, **_means(verdicts, keys), "ms": ms}


def _means(verdicts: Sequence[Judged], keys: Iterable[str]) -> dict[str, float]:
    """Average each figure over the windows that have it; NaN without one."""
    values = {key: [v.figures[key] for v in verdicts] for key in keys}
    there = {key: [one for one in all_ if one == one] for key, all_ in values.items()}
    return {key: fmean(all_) if all_ else float("nan") for key, all_ in there.items()}


def bundle_tables(judged: Mapping[str, Sequence[Judged]]) -> list[ResultTable]:
    """Return the quality and times of bundles' proposals, and the quality of their goals."""
    rows, of_goals = [], []
    for name, verdicts in judged.items():
        proposed = [verdict.proposals for verdict in verdicts if verdict.proposals]
        if not proposed:
            continue
        mean = _means(verdicts, ("PDMS", "oracle", "minADE", "rank"))
        times = {
            "inputs ms": median(each.drawing_ms for each in proposed),
            "flow ms": median(each.flow_ms for each in proposed),
            "ms": median(verdict.ms for verdict in verdicts),
        }
        rows.append({"driver": name, "N": len(proposed[0].trajectories), **mean, **times})
        if GOAL_FIGURES[0] in verdicts[0].figures:
            of_goals.append({"driver": name, **_means(verdicts, GOAL_FIGURES)})
    tables = [
        ResultTable("Proposals", rows, PROPOSALS_NOTE),
        ResultTable("Goals", of_goals, GOALS_NOTE),
    ]
    return [table for table in tables if table.rows]


def _by_log(judged: Mapping[str, Sequence[Judged]]) -> ResultTable:
    logs = dict.fromkeys(verdict.log for verdicts in judged.values() for verdict in verdicts)
    rows: list[Row] = []
    for log in logs:
        of_log = {name: [v for v in all_ if v.log == log] for name, all_ in judged.items()}
        count = len(next(iter(of_log.values())))
        means = {name: _means(all_, ("PDMS",))["PDMS"] for name, all_ in of_log.items()}
        rows.append({"log": log, "windows": count, **means})
    return ResultTable("PDMS by log", rows, "Windows of one log overlap in time.")


def _write(path: Path, verdicts: Sequence[Judged], trajectories: Sequence[Array]) -> Path:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(
            path,
            log=np.array([verdict.log for verdict in verdicts]),
            window=np.array([verdict.window for verdict in verdicts]),
            trajectories=np.stack(trajectories),
            **_proposed(verdicts),  # pyright: ignore[reportArgumentType] - arrays by their names
        )
    except OSError as error:
        raise BenchmarkError(f"{path}: {error.strerror}") from error
    return path


def _proposed(verdicts: Sequence[Judged]) -> dict[str, Array]:
    """Return all proposals and scores of a bundle."""
    proposed = [verdict.proposals for verdict in verdicts if verdict.proposals]
    scores = [each.scores for each in proposed if each.scores is not None]
    found = {"proposals": [each.trajectories for each in proposed], "scores": scores}
    return {name: np.stack(arrays) for name, arrays in found.items() if arrays}


def drive(
    *,
    logs: Annotated[Path, typer.Option(help="Folder of driving logs (*.npz).")],
    drivers: Annotated[
        str, typer.Option(metavar="A,B", help="Who drives; none for none.", show_default="all")
    ] = ",".join(ENTRIES),
    bundle: options.DrivingBundles = None,
    along_route: options.AlongRoute = False,
    guarded: options.Guarded = False,
    foreseeing: options.Foreseeing = False,
    route_drives: options.RouteDrives = False,
    late_ms: options.Late = None,
    num: options.Num = 64,
    samplers: options.Samplers = CARD,
    seeds: Annotated[
        list[int] | None,
        typer.Option("--seed", help="Of a bundle's noise; repeatable.", show_default="0", min=0),
    ] = None,
    threads: options.Threads = None,
    plans: Annotated[
        Path | None,
        folder_option("Folder that plans_*.npz are written to.", show_default="that of --out"),
    ] = None,
    recorded: options.Record = False,
    out: options.Out = options.RESULTS,
) -> None:
    """Score drivers and bundles on recorded logs with the PDM score; tables and plans."""
    found = read_logs(logs)
    chosen = named_drivers(options.comma_separated(drivers))
    asked = samplers.split(",")
    ours = open_drivers(bundle or [], num=num, samplers=asked, threads=threads)
    ways = ways_to_drive(
        ours,
        along_route=along_route,
        guarded=guarded,
        foreseeing=foreseeing,
        route_drives=route_drives,
    )
    for way in ways:
        seeded = [way.seeded(seed) for seed in seeds or [0]]
        chosen |= {each.name: Entry(each) for each in seeded}
    for name, entry in list(chosen.items()):
        if late_ms and entry.times is PLAN_TIMES and name != "human":
            chosen |= _late(entry.driver, name, late_ms)
    windows = sum(log.windows for log in found)
    with progress("driving", windows) as advance:
        judged = judge_drivers(chosen, found, progress=advance)
    sensors = kinds_of(log.sensors for log in found)
    about = {"logs": f"{logs.name}: {len(found)} files, {windows} windows", "sensors": sensors}
    tables = drive_tables(judged)
    report("Drive", about, tables, out)
    if recorded:
        firsts = ours[:: len(asked)]
        names = [driver.seeded((seeds or [0])[0]).name for driver in firsts]
        record(zip(names, bundle or [], strict=True), about, tables[0])
    for path in write_plans(judged, plans or out):
        say(str(path))
