"""Processes killed while retrying clients ask: does any request fail, and who answers?"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter

from anchorflow_benchmarks.clients import Outcomes, asking, retrying
from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.linux_processes import descendants
from anchorflow_benchmarks.programs import Served, running_service, served
from anchorflow_benchmarks.report import ResultTable, Row, tally
from anchorflow_client.contract import AnchorRequest

REPLACED_S = 60.0
"""In which a process that was killed has to be replaced."""
TIMEOUT_S = 20.0
LOOK_S = 0.1


@dataclass(frozen=True)
class KillConfig:
    """So many clients for so long, and so many kills in it, at equal distances."""

    clients: int = 4
    seconds: float = 30.0
    kills: int = 2
    processes: int = 2
    patience_s: float = 30.0


@dataclass(frozen=True)
class Victims:
    """A service of several processes that can be killed."""

    title: str
    words: str
    """In the command line of each of them."""
    serve: Callable[[], AbstractContextManager[Served]]


def kill_table(
    bundle: Path,
    requests: Sequence[AnchorRequest],
    config: KillConfig,
    *,
    progress: Callable[[str], None] = lambda _: None,
) -> ResultTable:
    """A row for workers of `anchorflow serve`, and one for replicas where Ray is installed.

    Raises:
        BenchmarkError: a service does not start, or does not replace what was killed.
    """
    number = str(config.processes)
    victims = [
        Victims(
            f"worker of serve --workers {number}",
            "spawn_main",
            lambda: served("--bundle", str(bundle), "--workers", number, "--threads", "1"),
        )
    ]
    note = f"{config.clients} retrying clients for {config.seconds:g} s"
    if find_spec("ray") is None:
        note += "; Ray is not installed here"
    else:
        serve = Victims("Ray replica", "ray::ServeReplica", lambda: _on_ray(bundle, number))
        victims.append(serve)
    rows = [_row(each, requests, config, progress) for each in victims]
    return ResultTable("Kills", rows, note)


def _row(
    victims: Victims,
    requests: Sequence[AnchorRequest],
    config: KillConfig,
    progress: Callable[[str], None],
) -> Row:
    attempts = Outcomes()
    with victims.serve() as service:
        connect = retrying(service.url, attempts, timeout_s=TIMEOUT_S, patience_s=config.patience_s)
        with asking(connect, requests, callers=config.clients, seconds=config.seconds) as outcomes:
            took_s = _kill_by_turns(victims, service.pid, config, progress)
    return {
        "killed": victims.title,
        "kills": len(took_s),
        "answers": len(outcomes.ms),
        "failed": outcomes.failed,
        "errors": tally(outcomes.errors),
        "attempts repeated": tally(attempts.errors),
        "p50 ms": outcomes.p50_ms,
        "p99 ms": outcomes.p99_ms,
        "longest ms": outcomes.longest_ms,
        "another process after s": max(took_s),
        "answered by": tally({f"{m.name} {m.version}": n for m, n in outcomes.models.items()}),
    }


def _kill_by_turns(
    victims: Victims,
    pid: int,
    config: KillConfig,
    progress: Callable[[str], None],
) -> list[float]:
    """The oldest process each time; gives the times in s until another was there."""
    took_s: list[float] = []
    until = perf_counter() + config.seconds
    apart_s = config.seconds / (config.kills + 1)
    for turn in range(config.kills):
        time.sleep(max(0.0, until - (config.kills - turn) * apart_s - perf_counter()))
        before = descendants(pid, victims.words)
        if len(before) != config.processes:
            raise BenchmarkError(f"expected {config.processes} processes, found {len(before)}")
        killed = min(before)
        os.kill(killed, signal.SIGKILL)
        start = perf_counter()
        while not descendants(pid, victims.words) - before:
            if perf_counter() - start > REPLACED_S:
                raise BenchmarkError(f"nothing took the place of process {killed}")
            time.sleep(LOOK_S)
        took_s.append(perf_counter() - start)
        progress(f"{victims.title}: {killed} was killed, another began {took_s[-1]:.1f} s later")
    return took_s


def _on_ray(bundle: Path, replicas: str) -> AbstractContextManager[Served]:
    """The same service on Ray, in a process of its own."""
    module = "anchorflow_benchmarks.serving.ray_server"
    command = (sys.executable, "-m", module, str(bundle), replicas)
    env = {**os.environ, "RAY_AUTH_MODE": "disabled"}
    return running_service("the service on Ray", command, env=env)
