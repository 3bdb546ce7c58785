"""Failover: a client asks at a fixed rate while a replica is killed in mid-answer and comes back.

Who was asked and who answered is what the client's own log says.
"""

from __future__ import annotations

import logging
import queue
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass

from anchorflow_benchmarks.clients import Outcomes
from anchorflow_benchmarks.programs import Program
from anchorflow_benchmarks.report import ResultTable, Row, tally
from anchorflow_client.base_client import BaseClient
from anchorflow_client.contract import AnchorBatch, AnchorRequest
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

    outcomes: Outcomes
    seen: Witness
    killed: str
    after_return: Counter[str]
    """Answers by replica since the killed one was started again."""

    def tables(self, config: FailoverConfig) -> list[ResultTable]:
        """One line for all requests, one for each replica."""
        outcomes, seen = self.outcomes, self.seen
        whole: Row = {
            "asked": len(outcomes.ms) + outcomes.failed,
            "answered": len(outcomes.ms),
            "lost": outcomes.failed,
            "errors": tally(outcomes.errors),
            "p50 ms": outcomes.p50_ms,
            "p99 ms": outcomes.p99_ms,
            "longest ms": outcomes.longest_ms,
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
    replicas: Sequence[Program],
    request: AnchorRequest,
    config: FailoverConfig,
    progress: Callable[[str], None] = lambda _: None,
) -> Outcome:
    """Asks by the clock, kills the first replica that is asked at the set time, starts it again."""
    by_name = {replica.name: replica for replica in replicas}
    outcomes = Outcomes()
    with witness() as seen, ThreadPoolExecutor(1) as executor:
        client.plan_request(request)  # the connection, not counted
        asking = executor.submit(_ask_by_the_clock, client, request, config, outcomes)
        time.sleep(config.kill_at * config.seconds)
        killed = kill_in_mid_answer(by_name, seen, after_s=config.mid_answer_s)
        progress(f"killed {killed}")
        time.sleep(max(0.0, (config.back_at - config.kill_at) * config.seconds))
        by_name[killed].start()
        progress(f"{killed} is back")
        before = Counter(seen.answered)
        asking.result()
    return Outcome(outcomes, seen, killed, seen.answered - before)


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


def kill_in_mid_answer(by_name: Mapping[str, Program], seen: Witness, *, after_s: float) -> str:
    """Waits until a replica is asked, and kills it before it can have answered."""
    asked: queue.SimpleQueue[str] = queue.SimpleQueue()
    seen.on_asking = asked.put
    victim = asked.get()
    seen.on_asking = lambda _: None
    time.sleep(after_s)
    by_name[victim].kill()
    return victim


def _ask_by_the_clock(
    client: BaseClient, request: AnchorRequest, config: FailoverConfig, outcomes: Outcomes
) -> None:
    """A request every tick, whether the one before is answered or not."""
    with ThreadPoolExecutor(MOST_AT_A_TIME) as executor:
        start = time.monotonic()
        waiting: list[Future[AnchorBatch]] = []
        for tick in range(int(config.hz * config.seconds)):
            time.sleep(max(0.0, start + tick / config.hz - time.monotonic()))
            waiting.append(executor.submit(outcomes.ask, client.plan_request, request))
        for each in waiting:
            with suppress(AnchorFlowError):  # it is among the outcomes
                each.result()
