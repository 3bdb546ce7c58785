"""Processes killed while retrying clients ask: does any request fail, and who answers?"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter

from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.report import ResultTable, Row
from anchorflow_benchmarks.serving.processes import descendants
from anchorflow_benchmarks.serving.served import Served, served
from anchorflow_benchmarks.turns import p50, p99
from anchorflow_client.contract import AnchorBatch, AnchorRequest
from anchorflow_client.errors import AnchorFlowError
from anchorflow_client.http import AnchorClient
from anchorflow_client.retry import RetryingClient

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


@dataclass
class Seen:
    """What the clients saw; they share it under its lock."""

    ms: list[float] = field(default_factory=list)
    """From asking to the answer, repetitions included."""
    answered_by: Counter[str] = field(default_factory=Counter)
    """Versions of the models."""
    repeated: Counter[str] = field(default_factory=Counter)
    """Attempts that came to nothing, by error."""
    failed: Counter[str] = field(default_factory=Counter)
    """Requests that did, by error."""
    lock: threading.Lock = field(default_factory=threading.Lock)


class Attempts(AnchorClient):
    """A client that counts the attempts that fail."""

    def __init__(self, url: str, seen: Seen) -> None:
        super().__init__(url, timeout_s=TIMEOUT_S)
        self._seen = seen

    def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        """As the client's own."""
        try:
            return super().plan_request(request)
        except AnchorFlowError as error:
            with self._seen.lock:
                self._seen.repeated[type(error).__name__] += 1
            raise


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
    seen = Seen()
    with victims.serve() as service:
        until = perf_counter() + config.seconds
        threads = [
            threading.Thread(
                target=_client, args=(service.url, requests, turn, until, config, seen)
            )
            for turn in range(config.clients)
        ]
        for thread in threads:
            thread.start()
        took_s = _kill_by_turns(victims, service.pid, until, config, progress)
        for thread in threads:
            thread.join()
    return {
        "killed": victims.title,
        "kills": len(took_s),
        "answers": len(seen.ms),
        "failed": sum(seen.failed.values()),
        "errors": _told(seen.failed),
        "attempts repeated": _told(seen.repeated),
        "p50 ms": p50(seen.ms),
        "p99 ms": p99(seen.ms),
        "longest ms": max(seen.ms),
        "another process after s": max(took_s),
        "answered by": _told(seen.answered_by),
    }


def _client(
    url: str,
    requests: Sequence[AnchorRequest],
    turn: int,
    until: float,
    config: KillConfig,
    seen: Seen,
) -> None:
    with RetryingClient(Attempts(url, seen), patience_s=config.patience_s) as client:
        while (start := perf_counter()) < until:
            turn += 1
            try:
                batch = client.plan_request(requests[turn % len(requests)])
            except AnchorFlowError as error:
                with seen.lock:
                    seen.failed[type(error).__name__] += 1
                continue
            with seen.lock:
                seen.ms.append((perf_counter() - start) * 1e3)
                seen.answered_by[f"{batch.model.name} {batch.model.version}"] += 1


def _kill_by_turns(
    victims: Victims,
    pid: int,
    until: float,
    config: KillConfig,
    progress: Callable[[str], None],
) -> list[float]:
    """The oldest process each time; gives the times in s until another was there."""
    took_s: list[float] = []
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


@contextmanager
def _on_ray(bundle: Path, replicas: str) -> Iterator[Served]:
    """The same service on Ray, in a process of its own."""
    module = "anchorflow_benchmarks.serving.ray_server"
    command = (sys.executable, "-m", module, str(bundle), replicas)
    with subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "RAY_AUTH_MODE": "disabled"},
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        for line in process.stdout:
            if " at " in line:
                break
        else:
            raise BenchmarkError("the service on Ray did not start")
        try:
            yield Served(line.partition(" at ")[2].strip(), process.pid)
        finally:
            process.stdin.close()


def _told(counts: Counter[str]) -> str:
    return ", ".join(f"{name} {n}" for name, n in sorted(counts.items())) or "none"
