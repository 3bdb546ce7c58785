"""Scores of the BARN challenge, and the tables of a contest.

    score = success × T* / clip(T, 2 T*, 8 T*),  T* = path_length / 2 m/s

Half a point is the most there is, for a robot that takes no longer than 2 T*.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from anchorflow_benchmarks.closed_loop.drive import End, Run
from anchorflow_benchmarks.report import ResultTable, Row
from anchorflow_benchmarks.turns import p50

OPTIMAL_SPEED = 2.0  # m/s, of T*
LEAST, MOST = 2.0, 8.0  # times T*, between which faster is better
CONFIDENCE = 1.96  # standard errors, on either side of a mean


@dataclass(frozen=True)
class Result:
    """One run of a contender in a world; latencies: ms of its requests for anchors."""

    contender: str
    world: str
    seed: int
    path_length: float
    run: Run
    latencies_ms: tuple[float, ...] = ()

    @property
    def score(self) -> float:
        return barn_score(self.run, self.path_length)


def barn_score(run: Run, path_length: float) -> float:
    """From 0, where the goal was not reached, to 0.5."""
    if run.end is not End.GOAL:
        return 0.0
    best_s = path_length / OPTIMAL_SPEED
    return best_s / float(np.clip(run.time_s, LEAST * best_s, MOST * best_s))


def contest_tables(results: Sequence[Result], contenders: Sequence[str]) -> list[ResultTable]:
    """A row a contender, and a row a world; gains are over the first contender."""
    of = {name: [r for r in results if r.contender == name] for name in contenders}
    first = of[contenders[0]]
    rows = [{"contender": name, **_row(of[name], first)} for name in contenders]
    note = (
        "score: success × T* / clip(T, 2 T*, 8 T*), at most 0.5; gain: over the first row, with "
        "its 95 % interval over the worlds; times and speeds are those of runs that arrived"
    )
    return [ResultTable("Contenders", rows, note), _world_table(of)]


def _row(own: Sequence[Result], first: Sequence[Result]) -> Row:
    runs = [result.run for result in own]
    arrived = [run for run in runs if run.end is End.GOAL]
    latencies = [ms for result in own for ms in result.latencies_ms]
    gains = _by_world(own) - _by_world(first)
    error = CONFIDENCE * gains.std(ddof=1) / np.sqrt(len(gains)) if len(gains) > 1 else np.nan
    return {
        "score": float(np.mean([result.score for result in own])),
        "gain": None if own is first else float(gains.mean()),
        "±": None if own is first else float(error),
        "arrived": len(arrived),
        "collisions": sum(run.end is End.COLLISION for run in runs),
        "timeouts": sum(run.end is End.TIMEOUT for run in runs),
        "time s": _mean([run.time_s for run in arrived]),
        "speed m/s": _mean([run.length / run.time_s for run in arrived]),
        "clearance m": _mean([run.clearance for run in arrived]),
        "ticks braked": sum(run.ticks_braked for run in runs),
        "request p50 ms": p50(latencies) if latencies else None,
    }


def _world_table(of: dict[str, list[Result]]) -> ResultTable:
    """What became of every run: its score, and why where it is 0."""
    worlds = list(dict.fromkeys(result.world for results in of.values() for result in results))
    rows = [
        {"world": world}
        | {
            name: " ".join(_told(result) for result in results if result.world == world)
            for name, results in of.items()
        }
        for world in worlds
    ]
    return ResultTable("Worlds", rows)


def _told(result: Result) -> str:
    return f"{result.score:.3f}" if result.run.end is End.GOAL else result.run.end.value


def _by_world(results: Sequence[Result]) -> np.ndarray:
    """Mean score of each world, in the order of their first runs: [W]."""
    scores: dict[str, list[float]] = {}
    for result in results:
        scores.setdefault(result.world, []).append(result.score)
    return np.array([np.mean(values) for values in scores.values()])


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None
