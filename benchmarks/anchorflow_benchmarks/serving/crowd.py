"""A crowd: closed-loop clients with a budget, and a probe that asks for health meanwhile."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter

from anchorflow_client.contract import AnchorRequest
from anchorflow_client.errors import AnchorFlowError, Overloaded
from anchorflow_client.http import AnchorClient

TIMEOUT_S = 120.0
# In a process of its own: what is measured is the server's delay, not that of 64 threads here.
PROBE = """
import http.client, json, sys, time
host, port, seconds, pause_s = sys.argv[1], int(sys.argv[2]), float(sys.argv[3]), 0.1
connection, times, until = http.client.HTTPConnection(host, port), [], time.perf_counter() + seconds
while (start := time.perf_counter()) < until:
    connection.request("GET", "/v2/health/ready")
    answer = connection.getresponse()
    answer.read()
    assert answer.status == 200, answer.status
    times.append((time.perf_counter() - start) * 1e3)
    time.sleep(pause_s)
print(json.dumps(times))
"""


@dataclass(frozen=True)
class CrowdConfig:
    """So many clients, each of which asks again as soon as it has its answer.

    budget_ms: of every request; None: they wait as long as it takes
    """

    clients: int = 64
    seconds: float = 10.0
    budget_ms: float | None = None


@dataclass
class Seen:
    """What the crowd saw; its clients share it under its lock."""

    answered_ms: list[float] = field(default_factory=list)
    """From sending to the whole answer."""
    versions: Counter[str] = field(default_factory=Counter)
    """Of the models that answered."""
    refused: Counter[str] = field(default_factory=Counter)
    """By the code of the error."""
    health_ms: list[float] = field(default_factory=list)
    elapsed_s: float = 0.0
    lock: threading.Lock = field(default_factory=threading.Lock)

    @property
    def per_second(self) -> float:
        """Answers."""
        return len(self.answered_ms) / self.elapsed_s

    def late(self, budget_ms: float) -> int:
        """Answers that came later than the budget and a tenth of it."""
        return sum(ms > 1.1 * budget_ms for ms in self.answered_ms)


def crowd(url: str, requests: Sequence[AnchorRequest], config: CrowdConfig) -> Seen:
    """Let the crowd ask a server; a client that is told to come back later waits so long."""
    seen = Seen()
    asked = [replace(request, budget_ms=config.budget_ms) for request in requests]
    host, port = url.removeprefix("http://").split(":")
    probe = (sys.executable, "-c", PROBE, host, port, str(config.seconds))
    with subprocess.Popen(probe, stdout=subprocess.PIPE, text=True) as health:
        start = perf_counter()
        until = start + config.seconds
        threads = [
            threading.Thread(target=_client, args=(url, asked, turn, until, seen))
            for turn in range(config.clients)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        seen.elapsed_s = perf_counter() - start
        assert health.stdout is not None
        seen.health_ms = json.loads(health.stdout.read())
    return seen


def _client(
    url: str, requests: Sequence[AnchorRequest], turn: int, until: float, seen: Seen
) -> None:
    with AnchorClient(url, timeout_s=TIMEOUT_S) as client:
        while perf_counter() < until:
            start = perf_counter()
            try:
                batch = client.plan_request(requests[turn % len(requests)])
            except AnchorFlowError as error:
                with seen.lock:
                    seen.refused[getattr(error, "code", type(error).__name__)] += 1
                if isinstance(error, Overloaded):
                    _wait(min(error.retry_after_s or 0.0, until - perf_counter()))
            else:
                with seen.lock:
                    seen.answered_ms.append((perf_counter() - start) * 1e3)
                    seen.versions[batch.model.version] += 1
            turn += 1


def _wait(seconds: float) -> None:
    threading.Event().wait(max(0.0, seconds))
