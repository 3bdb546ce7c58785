"""Soak: does a server that has answered for a long while still hold what it held at first?"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from time import perf_counter

from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.load import Connect
from anchorflow_benchmarks.report import ResultTable, Row
from anchorflow_benchmarks.turns import p50, p99
from anchorflow_client.contract import AnchorRequest

MB = 2.0**20


@dataclass(frozen=True)
class SoakConfig:
    """A soak ends after `requests` or `seconds`, whichever comes first.

    warm_up: requests before the first reading, while arenas and caches fill
    readings: how often memory and descriptors are read
    """

    requests: int = 10_000
    seconds: float = 3600.0
    warm_up: int = 500
    readings: int = 10


@dataclass(frozen=True)
class Held:
    """What a process holds: resident memory in MB, and open descriptors."""

    memory_mb: float
    descriptors: int

    @staticmethod
    def by(pid: int) -> Held:
        """Read from /proc. Raises `BenchmarkError` where the process or /proc is not there."""
        folder = Path("/proc") / str(pid)
        try:
            lines = (folder / "status").read_text().splitlines()
            descriptors = sum(1 for _ in (folder / "fd").iterdir())
        except OSError as error:
            raise BenchmarkError(f"cannot read what process {pid} holds: {error}") from error
        kilobytes = next(int(line.split()[1]) for line in lines if line.startswith("VmRSS:"))
        return Held(kilobytes * 1024 / MB, descriptors)


def soak_table(
    connect: Connect,
    pid: int,
    requests: Sequence[AnchorRequest],
    config: SoakConfig,
    progress: Callable[[int], None] = lambda _: None,
) -> ResultTable:
    """Memory and descriptors of the server `pid`, again and again while one client asks.

    Raises:
        AnchorFlowError: a request failed.
        BenchmarkError: the process cannot be read.
    """
    rows: list[Row] = []
    with ExitStack() as stack:
        ask = connect(stack)
        for turn in range(config.warm_up):
            ask(requests[turn % len(requests)])
        first, start, done = Held.by(pid), perf_counter(), 0
        rows.append({"requests": 0, "memory MB": first.memory_mb, "descriptors": first.descriptors})
        marks = [config.requests * k // config.readings for k in range(config.readings + 1)]
        for before, after in pairwise(marks):
            times = []
            for turn in range(before, after):
                asked = perf_counter()
                ask(requests[turn % len(requests)])
                times.append((perf_counter() - asked) * 1e3)
                if asked - start > config.seconds:
                    break
            done += len(times)
            progress(len(times))
            rows.append(_reading(done, Held.by(pid), first, times))
            if perf_counter() - start > config.seconds:
                break
    note = f"one client, after {config.warm_up} requests to warm up"
    return ResultTable("Soak", rows, note)


def _reading(done: int, held: Held, first: Held, times: list[float]) -> Row:
    return {
        "requests": done,
        "memory MB": held.memory_mb,
        "grown by MB": held.memory_mb - first.memory_mb,
        "descriptors": held.descriptors,
        "p50 ms": p50(times),
        "p99 ms": p99(times),
    }
