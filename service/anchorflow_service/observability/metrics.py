"""Counts and durations for Prometheus: of calls on every transport, and of HTTP exchanges."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path

from prometheus_client import CollectorRegistry, Counter, Histogram, ProcessCollector
from prometheus_client.exposition import generate_latest
from prometheus_client.multiprocess import MultiProcessCollector

from anchorflow_client.errors import AnchorFlowError
from anchorflow_service.observability.collector import ServiceCollector
from anchorflow_service.observability.exchanges import Exchange
from anchorflow_service.planning import ANSWERED, Call, Observer, PlanningService

SECONDS = (0.001, 0.0025, 0.005, 0.01, 0.02, 0.04, 0.06, 0.08, 0.1, 0.15, 0.25, 0.5, 1.0, 2.5, 10.0)
SIZES = (1, 2, 4, 8, 16, 32, 64)
STAGES = ("encode", "sample", "refine")
SHARED_FOLDER = "PROMETHEUS_MULTIPROC_DIR"
"""prometheus_client's variable: the folder of the files in which processes count together."""
SHARED_BYTES = 512 * 2**10
"""Of each of a process's two files there; a service of a hundred models fills half."""


class SharedFolderError(AnchorFlowError):
    """There is no room to count in, or the folder is another user's."""


class Metrics(Observer):
    """The metrics of one service, in registries of their own.

    Where prometheus_client counts in files that several processes share, which its variable
    `PROMETHEUS_MULTIPROC_DIR` says, counts and histograms are those of all of them; what is read
    off the service at the moment of asking is this process's.

    No label takes its value from a caller, whose inventions would fill the memory.
    """

    def __init__(self, service: PlanningService) -> None:
        self._rendered = [registry := CollectorRegistry()]
        seen = registry
        if os.environ.get(SHARED_FOLDER):
            self._rendered = [counted := CollectorRegistry(), seen := CollectorRegistry()]
            MultiProcessCollector(counted)
        self._requests = Counter(
            "anchorflow_requests",
            "Planning requests by transport, model (empty where none was chosen) and outcome: ok, "
            "cancelled, or the code of the error.",
            ["transport", "model", "outcome"],
            registry=registry,
        )
        self._total = _seconds(
            "request", "From arrival to the answer, of what was answered.", registry, ["transport"]
        )
        self._queue = _seconds("queue", "Age of a request when a worker took it.", registry, [])
        stages = _seconds("stage", "Engine time of an answer.", registry, ["stage"])
        self._stages = {stage: stages.labels(stage) for stage in STAGES}
        self._batch = Histogram(
            "anchorflow_batch_requests",
            "Requests that went through an engine together.",
            buckets=SIZES,
            registry=registry,
        )
        self._exchanges = Counter(
            "anchorflow_http_responses",
            "HTTP answers by route and status; those that never became a planning request too.",
            ["route", "status"],
            registry=registry,
        )
        seen.register(ServiceCollector(service))
        # Its own numbers only: the interpreter's version is nobody's business.
        ProcessCollector(registry=seen)
        service.watch(self)

    def ended(self, call: Call, outcome: str) -> None:
        """Count it, and its times where it was answered."""
        model = call.model_id.name if call.model_id else ""
        self._requests.labels(call.transport, model, outcome).inc()
        if outcome == ANSWERED:
            self._total.labels(call.transport).observe(call.arrival.elapsed_ms / 1e3)
            self._queue.observe(call.timing_ms["queue"] / 1e3)
            for stage, seconds in self._stages.items():
                seconds.observe(call.timing_ms.get(stage, 0.0) / 1e3)

    def batch_planned(self, requests: int) -> None:
        """Count it."""
        self._batch.observe(requests)

    def exchanged(self, exchange: Exchange) -> None:
        """Count an HTTP answer."""
        self._exchanges.labels(exchange.route, str(exchange.status)).inc()

    def render(self) -> bytes:
        """All of them, in Prometheus's text format 0.0.4."""
        return b"".join(map(generate_latest, self._rendered))


def reserve_shared_files() -> None:
    """Take from the disk what this process counts in, and make the folder anew where it is gone.

    It counts in memory that is mapped to its files: a disk that is full only then ends the process.

    Raises:
        SharedFolderError: saying what is wrong.
    """
    folder = Path(os.environ[SHARED_FOLDER])
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        if folder.stat().st_uid != os.getuid():
            raise SharedFolderError(f"{folder}: expected a folder of this user")
        for kind in ("counter", "histogram"):
            with (folder / f"{kind}_{os.getpid()}.db").open("ab") as file:
                if sys.platform != "darwin":  # which has no such call
                    os.posix_fallocate(file.fileno(), 0, SHARED_BYTES)
    except OSError as error:
        raise SharedFolderError(f"{folder}: cannot be written: {error.strerror}") from error


def _seconds(
    name: str, description: str, registry: CollectorRegistry, labels: Sequence[str]
) -> Histogram:
    return Histogram(
        f"anchorflow_{name}_seconds", description, labels, buckets=SECONDS, registry=registry
    )
