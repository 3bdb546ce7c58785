"""Failover: a client asks at a fixed rate while a replica is killed in mid-answer and comes back.

Who was asked and who answered is what the client's own log says.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field

from anchorflow_benchmarks.report import ResultTable, Row
from anchorflow_benchmarks.turns import p50, p99
from anchorflow_benchmarks.zenoh_processes import Process
from anchorflow_client.base_client import BaseClient
from anchorflow_client.contract import AnchorRequest
from anchorflow_client.errors import AnchorFlowError

CLIENT_LOG = "anchorflow_client.zenoh_client.failover"
MOST_AT_A_TIME = 64


@dataclass(frozen=True)
class FailoverConfig:
    """When what happens; the moments are shares of the whole time."""

    hz: float = 20.0
    seconds: float = 60.0
    kill_at: float = 0.3
    back_at: float = 0.5
    mid_answer_s: float = 0.01
    """How long after it was asked the replica is killed; it must take longer to answer."""


@dataclass
class Tally:
    """What became of the requests."""

    asked: int = 0
    ms: list[float] = field(default_factory=list)
    errors: Counter[str] = field(default_factory=Counter)
    lock: threading.Lock = field(default_factory=threading.Lock)


class Witness(logging.Handler):
    """Reads the client's log: who was asked, who answered, from whom nothing came."""

    def __init__(self) -> None:
        super().__init__(logging.DEBUG)
        self.asked: Counter[str] = Counter()
        self.answered: Counter[str] = Counter()
        self.silent: Counter[str] = Counter()
        self.on_asking: Callable[[str], None] = lambda _: None

    def emit(self, record: logging.LogRecord) -> None:
        words, args = str(record.msg), record.args
        if not isinstance(args, tuple) or len(args) < 2:
            return
        name = str(args[1])
        if "asking" in words:
            self.asked[name] += 1
            self.on_asking(name)
        elif "answered in" in words:
            self.answered[name] += 1
        elif "nothing came" in words:
            self.silent[name] += 1


@dataclass(frozen=True)
class Outcome:
    """A whole run."""

    tally: Tally
    seen: Witness
    killed: str
    after_return: Counter[str]
    """Answers by replica since the killed one was started again."""

    def tables(self, config: FailoverConfig) -> list[ResultTable]:
        """One line for all requests, one for each replica."""
        tally, seen = self.tally, self.seen
        lost = ", ".join(f"{name} {n}" for name, n in tally.errors.items()) or "none"
        whole: Row = {
            "asked": tally.asked,
            "answered": len(tally.ms),
            "lost": sum(tally.errors.values()),
            "errors": lost,
            "p50 ms": p50(tally.ms),
            "p99 ms": p99(tally.ms),
            "longest ms": max(tally.ms),
        }
        rows: list[Row] = [
            {
                "replica": name,
                "killed": "in mid-answer" if name == self.killed else "no",
                "asked": seen.asked[name],
                "answered": seen.answered[name],
                "asked in vain": seen.silent[name],
                "answered since the return": self.after_return[name],
            }
            for name in sorted(seen.asked)
        ]
        note = f"{config.hz:g} Hz for {config.seconds:g} s"
        return [ResultTable("Requests", [whole], note), ResultTable("Who answered", rows)]


def failover(
    client: BaseClient,
    replicas: Sequence[Process],
    request: AnchorRequest,
    config: FailoverConfig,
    progress: Callable[[str], None] = lambda _: None,
) -> Outcome:
    """Asks by the clock, kills the first replica that is asked at the set time, starts it again."""
    by_name = {replica.name: replica for replica in replicas}
    tally = Tally()
    with witness() as seen, ThreadPoolExecutor(1) as executor:
        client.plan_request(request)  # the connection, not counted
        asking = executor.submit(_ask_by_the_clock, client, request, config, tally)
        time.sleep(config.kill_at * config.seconds)
        killed = kill_in_mid_answer(by_name, seen, after_s=config.mid_answer_s)
        progress(f"killed {killed}")
        time.sleep(max(0.0, (config.back_at - config.kill_at) * config.seconds))
        by_name[killed].start()
        progress(f"{killed} is back")
        before = Counter(seen.answered)
        asking.result()
    return Outcome(tally, seen, killed, seen.answered - before)


@contextmanager
def witness() -> Iterator[Witness]:
    """Reads the client's log while the block lasts."""
    log, seen = logging.getLogger(CLIENT_LOG), Witness()
    level = log.level
    log.addHandler(seen)
    log.setLevel(logging.DEBUG)
    try:
        yield seen
    finally:
        log.removeHandler(seen)
        log.setLevel(level)


def kill_in_mid_answer(by_name: Mapping[str, Process], seen: Witness, *, after_s: float) -> str:
    """Waits until a replica is asked, and kills it before it can have answered."""
    asked: queue.SimpleQueue[str] = queue.SimpleQueue()
    seen.on_asking = asked.put
    victim = asked.get()
    seen.on_asking = lambda _: None
    time.sleep(after_s)
    by_name[victim].kill()
    return victim


def _ask_by_the_clock(
    client: BaseClient, request: AnchorRequest, config: FailoverConfig, tally: Tally
) -> None:
    """A request every tick, whether the one before is answered or not."""
    with ThreadPoolExecutor(MOST_AT_A_TIME) as executor:
        start = time.monotonic()
        waiting: list[Future[None]] = []
        for tick in range(int(config.hz * config.seconds)):
            time.sleep(max(0.0, start + tick / config.hz - time.monotonic()))
            waiting.append(executor.submit(_ask, client, request, tally))
        for each in waiting:
            each.result()


def _ask(client: BaseClient, request: AnchorRequest, tally: Tally) -> None:
    start, failed = time.perf_counter(), None
    try:
        client.plan_request(request)
    except AnchorFlowError as error:
        failed = error
    with tally.lock:
        tally.asked += 1
        if failed is None:
            tally.ms.append((time.perf_counter() - start) * 1e3)
        else:
            tally.errors[type(failed).__name__] += 1
