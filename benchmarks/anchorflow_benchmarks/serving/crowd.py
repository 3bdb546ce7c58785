"""A crowd: closed-loop clients with a budget, and a probe that asks for health meanwhile."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace

from anchorflow_benchmarks.clients import Outcomes
from anchorflow_benchmarks.serving.lean_callers import lean_callers
from anchorflow_client.contract import AnchorRequest

# In a process of its own: what is measured is the server's delay, not that of the callers here.
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


def crowd(
    url: str, requests: Sequence[AnchorRequest], config: CrowdConfig
) -> tuple[Outcomes, list[float]]:
    """Let the crowd ask a server: what became of it, and how long [ms] the server's health took."""
    asked = [replace(request, budget_ms=config.budget_ms) for request in requests]
    host, port = url.removeprefix("http://").split(":")
    probe = (sys.executable, "-c", PROBE, host, port, str(config.seconds))
    with subprocess.Popen(probe, stdout=subprocess.PIPE, text=True) as health:
        assert health.stdout is not None
        outcomes = lean_callers(url, asked, callers=config.clients, seconds=config.seconds)
        health_ms = json.loads(health.stdout.read())
    return outcomes, health_ms
