"""Score runs as the BARN challenge does, tabulate a contest, and keep its runs in a file.

    score = success × T* / clip(T, 2 T*, 8 T*),  T* = path_length / 2 m/s

The highest score is 0.5, for a robot that takes no longer than 2 T*.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from anchorflow_benchmarks import BenchmarkError
from anchorflow_benchmarks.closed_loop.drive import End, Run
from anchorflow_benchmarks.report import ResultTable, Row
from anchorflow_benchmarks.turns import p50

OPTIMAL_SPEED = 2.0  # m/s, of T*
FASTEST, SLOWEST = 2.0, 8.0  # times T*, bounds of the time that counts
CONFIDENCE = 1.96  # standard errors on either side of a mean

RunKey = tuple[str, str, int]
"""Contender, world, seed."""


@dataclass(frozen=True)
class Result:
    """One run of a contender in a world; latencies: ms of its requests for anchors.

    command_ms: median processor time of a command; None in logs of older versions
    """

    contender: str
    world: str
    seed: int
    path_length: float
    run: Run
    latencies_ms: tuple[float, ...] = ()
    command_ms: float | None = None

    @property
    def score(self) -> float:
        return barn_score(self.run, self.path_length)


def barn_score(run: Run, path_length: float) -> float:
    """Return 0 for a run that did not reach the goal, and up to 0.5 for the others."""
    if run.end is not End.GOAL:
        return 0.0
    best_s = path_length / OPTIMAL_SPEED
    return best_s / float(np.clip(run.time_s, FASTEST * best_s, SLOWEST * best_s))


def contest_tables(results: Sequence[Result], contenders: Sequence[str]) -> list[ResultTable]:
    """Return tables by contender and by world; gains are over the first contender."""
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
        "command ms": _mean([r.command_ms for r in own if r.command_ms is not None]),
    }


def _world_table(of: dict[str, list[Result]]) -> ResultTable:
    """Return the score of every run, or how it ended."""
    worlds = list(dict.fromkeys(result.world for results in of.values() for result in results))
    rows = [
        {"world": world}
        | {
            name: " ".join(_outcome(result) for result in results if result.world == world)
            for name, results in of.items()
        }
        for world in worlds
    ]
    return ResultTable("Worlds", rows)


def _outcome(result: Result) -> str:
    return f"{result.score:.3f}" if result.run.end is End.GOAL else result.run.end.value


def _by_world(results: Sequence[Result]) -> np.ndarray:
    """Return the mean scores [W] by world, in the order of their first runs."""
    scores: dict[str, list[float]] = {}
    for result in results:
        scores.setdefault(result.world, []).append(result.score)
    return np.array([np.mean(values) for values in scores.values()])


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None


@dataclass(frozen=True)
class RunLog:
    """A file of JSON lines: the settings of a contest, then one run per line."""

    path: Path
    settings: Mapping[str, str]

    def known(self) -> dict[RunKey, Result]:
        """Return the runs of the file, or start it; an incomplete last line is removed.

        Raises `BenchmarkError` if the file holds runs of other settings or something else, or
        cannot be read or written.
        """
        settings = json.dumps(dict(self.settings)) + "\n"
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self.path.touch()
            written = self.path.read_bytes()
            if settings.encode().startswith(written):
                self.path.write_text(settings, encoding="utf-8")
                return {}
            first, *lines, cut_off = written.split(b"\n")
            found, results = dict(json.loads(first)), [_result(json.loads(line)) for line in lines]
            for name in {**self.settings, **found}:
                wanted, got = self.settings.get(name), found.get(name)
                if wanted != got:
                    raise BenchmarkError(
                        f"{self.path}: {name}: expected runs of {wanted!r}, got runs of {got!r}; "
                        "another file begins anew"
                    )
            os.truncate(self.path, len(written) - len(cut_off))
        except OSError as error:
            raise BenchmarkError(f"{self.path}: {error.strerror}") from error
        except (ValueError, KeyError, TypeError) as error:
            raise BenchmarkError(f"{self.path}: not a file of runs ({error})") from error
        return {(result.contender, result.world, result.seed): result for result in results}

    def add(self, result: Result) -> None:
        """Append a run; raise `BenchmarkError` if that fails."""
        fields = asdict(result)
        fields["run"]["end"] = result.run.end.value
        try:
            with self.path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(fields) + "\n")
        except OSError as error:
            raise BenchmarkError(f"{self.path}: {error.strerror}") from error


def _result(fields: dict) -> Result:
    run = Run(**fields["run"] | {"end": End(fields["run"]["end"])})
    return Result(**fields | {"run": run, "latencies_ms": tuple(fields["latencies_ms"])})
