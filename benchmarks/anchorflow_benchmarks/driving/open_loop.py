"""Drivers on every window of some logs, open loop: nobody reacts to what they plan."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import fmean, median
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from anchorflow_benchmarks.driving.bundle_driver import BundleDriver, Proposals
from anchorflow_benchmarks.driving.proposals import (
    GOALS_NOTE,
    OF_GOALS,
    PROPOSALS_NOTE,
    proposal_figures,
)
from anchorflow_benchmarks.driving.rewards import choice_figures, choices_table, heads_table
from anchorflow_benchmarks.driving.seeds import seeds_table
from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.report import ResultTable, Row
from anchorflow_driving.drivers import DENSE_TIMES, DRIVERS, PLAN_TIMES, WAYPOINT_TIMES, Driver
from anchorflow_driving.log import COMMANDS, FRAME_S, DrivingLog
from anchorflow_driving.pdm import SUB_SCORES, PdmScorer, PdmScores
from anchorflow_driving.waypoints import collides
from anchorflow_driving.window import Scenes, Window

Array = NDArray[np.float64]

NOTE = (
    "Shares and scores from 0 to 1, distances in m. against: driven in lanes that lead the other"
    " way; ADE and FDE over the 8 poses of 4 s; hit: share of plans whose box, as 45 waypoints and"
    " untracked, overlaps another within 4.5 s; ms: median time of a plan."
)


@dataclass(frozen=True)
class Entry:
    """Who is judged, at which poses: 8, or all 40 that a driver has; or a bundle's proposals."""

    driver: Driver | BundleDriver
    times: Array = field(default_factory=lambda: PLAN_TIMES)


# PDM-Closed plans 40 poses; as 8, it is what a planner of 8 could have answered.
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
    proposals: Proposals | None = None  # of a bundle
    choices: Mapping[str, float] = field(default_factory=dict)  # that it could have made
    sub_scores: Array | None = None  # [N, 5] of its proposals


def named_drivers(names: Sequence[str]) -> dict[str, Entry]:
    """Rule-based drivers by name.

    Raises:
        BenchmarkError: one is unknown.
    """
    for name in names:
        if name not in ENTRIES:
            raise BenchmarkError(f"expected drivers among {', '.join(ENTRIES)}, got {name!r}")
    return {name: ENTRIES[name] for name in names}


def judge_drivers(
    drivers: Mapping[str, Entry],
    logs: Iterable[DrivingLog],
    *,
    progress: Callable[[int], None] = lambda _: None,
) -> dict[str, list[Judged]]:
    """Every driver's plan of every window, judged; `progress` hears of each window."""
    judged: dict[str, list[Judged]] = {name: [] for name in drivers}
    for log in logs:
        for window in Scenes(log):
            for name, verdict in _judge_window(drivers, window).items():
                judged[name].append(verdict)
            progress(1)
    return judged


def drive_tables(judged: Mapping[str, Sequence[Judged]]) -> list[ResultTable]:
    """All windows, by source, by command, and the PDMS by log."""
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
    """plans_DRIVER.npz of 8 poses and, of drivers that plan 4.5 s, waypoints_DRIVER.npz.

    Keys: log [W] file name without suffix, window [W], trajectories [W, 8, 3] or [W, 45, 2]; of
    bundles proposals [W, N, 8, 3] and, where it scores them, scores [W, N] too.

    Raises:
        BenchmarkError: a file cannot be written.
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
                **_sub_scores(scorer.judge(motion)),
                "against": float(scorer.metres_against(motion)[0]),
                **_distances(window, plan, entry.times),
                "hit": hit,
            },
            ms=ms,
        )
        if proposals:
            verdict = _of_bundle(verdict, proposals, window=window, scorer=scorer)
        judged[name] = verdict
    return judged


def _of_bundle(
    verdict: Judged, proposals: Proposals, *, window: Window, scorer: PdmScorer
) -> Judged:
    """The verdict on a bundle's plan, with what all that it proposed is worth."""
    scores = scorer.score(proposals.trajectories)
    figures = proposal_figures(window, proposals, pdms=scores.pdms)
    return replace(
        verdict,
        figures={**verdict.figures, **figures},
        proposals=proposals,
        choices=choice_figures(window, proposals, pdms=scores.pdms, scorer=scorer),
        sub_scores=scores.sub_scores,
    )


def _waypoints(driver: Driver | BundleDriver, window: Window) -> Array | None:
    """[45, 2] of a driver that plans 4.5 s."""
    if isinstance(driver, BundleDriver):
        return None
    waypoints = driver(window, WAYPOINT_TIMES)[:, :2]
    return waypoints if np.isfinite(waypoints).all() else None


def _sub_scores(scores: PdmScores) -> dict[str, float]:
    return {name.upper(): float(getattr(scores, name)[0]) for name in (*SUB_SCORES, "pdms")}


def _distances(window: Window, plan: Array, times: Array) -> dict[str, float]:
    at_plan_times = plan[np.searchsorted(times, PLAN_TIMES - FRAME_S / 2), :2]
    away = np.linalg.norm(at_plan_times - window.recorded(PLAN_TIMES)[:, :2], axis=-1)
    at = {f"L2 {second} s": float(away[2 * second - 1]) for second in (1, 2, 3, 4)}
    return {"ADE": float(away.mean()), "FDE": float(away[-1]), **at}


def _row(name: str, verdicts: Sequence[Judged]) -> Row:
    keys = [key for key in (verdicts[0].figures if verdicts else ()) if key not in OF_GOALS]
    ms = median(v.ms for v in verdicts) if verdicts else None
    return {"driver": name, **_means(verdicts, keys), "ms": ms}


def _means(verdicts: Sequence[Judged], keys: Iterable[str]) -> dict[str, float]:
    """Of the windows that have the figure; NaN where none has."""
    values = {key: [v.figures[key] for v in verdicts] for key in keys}
    there = {key: [one for one in all_ if one == one] for key, all_ in values.items()}
    return {key: fmean(all_) if all_ else float("nan") for key, all_ in there.items()}


def bundle_tables(judged: Mapping[str, Sequence[Judged]]) -> list[ResultTable]:
    """What bundles propose, in what time, and how good their goals and forecasts are."""
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
        if OF_GOALS[0] in verdicts[0].figures:
            of_goals.append({"driver": name, **_means(verdicts, OF_GOALS)})
    tables = [
        ResultTable("Proposals", rows, PROPOSALS_NOTE) if rows else None,
        ResultTable("Goals", of_goals, GOALS_NOTE) if of_goals else None,
        choices_table(
            {
                name: [{**v.choices, "PDMS": v.figures["PDMS"]} for v in all_]
                for name, all_ in judged.items()
            }
        ),
        heads_table(_foretold(judged)),
        seeds_table(
            {name: [v.figures["PDMS"] for v in verdicts] for name, verdicts in judged.items()}
        ),
    ]
    return [table for table in tables if table]


def _foretold(judged: Mapping[str, Sequence[Judged]]) -> dict[str, tuple[Array, Array]]:
    """Sub-scores [M, 5] as they were foretold and as they were, of all windows, by driver."""
    pairs = {
        name: [
            (v.proposals.foretold, v.sub_scores)
            for v in verdicts
            if v.proposals and v.proposals.foretold is not None and v.sub_scores is not None
        ]
        for name, verdicts in judged.items()
    }
    return {
        name: (
            np.concatenate([told for told, _ in each]),
            np.concatenate([true for _, true in each]),
        )
        for name, each in pairs.items()
        if each
    }


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
    """All proposals and their scores, of a bundle."""
    proposed = [verdict.proposals for verdict in verdicts if verdict.proposals]
    scores = [each.scores for each in proposed if each.scores is not None]
    found = {"proposals": [each.trajectories for each in proposed], "scores": scores}
    return {name: np.stack(arrays) for name, arrays in found.items() if arrays}
