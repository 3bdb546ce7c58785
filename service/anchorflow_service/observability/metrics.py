"""Metrics for Prometheus: counts and durations of calls and HTTP exchanges, and current load."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path

from prometheus_client import CollectorRegistry, Counter, Histogram, ProcessCollector
from prometheus_client.core import GaugeMetricFamily, InfoMetricFamily, Metric
from prometheus_client.exposition import generate_latest
from prometheus_client.multiprocess import MultiProcessCollector
from prometheus_client.registry import Collector

from anchorflow_client.errors import AnchorFlowError
from anchorflow_service.observability.logs import Exchange
from anchorflow_service.planning import ANSWERED, Call, Observer, PlanningService

SECONDS = (0.001, 0.0025, 0.005, 0.01, 0.02, 0.04, 0.06, 0.08, 0.1, 0.15, 0.25, 0.5, 1.0, 2.5, 10.0)
SIZES = (1, 2, 4, 8, 16, 32, 64)
STAGES = ("encode", "sample", "refine")
SHARED_FOLDER = "PROMETHEUS_MULTIPROC_DIR"
"""prometheus_client's variable: the folder of files in which processes count together."""
SHARED_BYTES = 512 * 2**10
"""Size of each of a process's two files there; a service of a hundred models fills half."""
TASKS = Path("/proc/self/task")
"""A folder for each thread of this process, on Linux."""


class SharedFolderError(AnchorFlowError):
    """The folder of counts cannot be written, or belongs to another user."""


class Metrics(Observer):
    """The metrics of one service, in registries of their own.

    If `PROMETHEUS_MULTIPROC_DIR` is set, counts and histograms are sums over all processes that
    share that folder; gauges are this process's own.

    No label takes its value from a caller, so the number of series is bounded.
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
        # Without the collector that would reveal the interpreter's version.
        ProcessCollector(registry=seen)
        service.watch(self)

    def ended(self, call: Call, outcome: str) -> None:
        """Count a call, and its durations if it was answered."""
        model = call.model_id.name if call.model_id else ""
        self._requests.labels(call.transport, model, outcome).inc()
        if outcome == ANSWERED:
            self._total.labels(call.transport).observe(call.arrival.elapsed_ms / 1e3)
            self._queue.observe(call.timing_ms["queue"] / 1e3)
            for stage, seconds in self._stages.items():
                seconds.observe(call.timing_ms.get(stage, 0.0) / 1e3)

    def batch_planned(self, requests: int) -> None:
        self._batch.observe(requests)

    def exchanged(self, exchange: Exchange) -> None:
        self._exchanges.labels(exchange.route, str(exchange.status)).inc()

    def render(self) -> bytes:
        """Return all metrics in Prometheus's text format 0.0.4."""
        return b"".join(map(generate_latest, self._rendered))


def reserve_shared_files() -> None:
    """Allocate the files in which this process counts. Raises `SharedFolderError`.

    The files are mapped into memory: a disk that becomes full later would kill the process.
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


class ServiceCollector(Collector):
    """Reads readiness, load, threads and bundles off a service at every scrape."""

    def __init__(self, service: PlanningService) -> None:
        self._service = service

    def collect(self) -> Iterator[Metric]:
        queue = self._service.queue
        for name, about, value in (
            ("ready", "1 while requests are taken.", float(self._service.is_ready)),
            ("in_flight", "Requests that wait or are planned.", queue.in_flight),
            ("oldest_wait_seconds", "Age of the first in the queue, or 0.", queue.oldest_wait_s),
            ("workers", "Engine calls at a time.", queue.num_lanes),
            ("threads", "Threads of the process, the engines' own included.", threads()),
        ):
            yield GaugeMetricFamily(f"anchorflow_{name}", about, value)
        family = InfoMetricFamily("anchorflow_bundle", "Bundles that are served.")
        for card in self._service.engines.cards():
            labels = {"model": card.name, "version": card.version, "sha256": card.sha256}
            family.add_metric([], labels)
        yield family


def threads() -> int:
    """Return the number of threads of this process; without Linux, those that Python knows."""
    try:
        return sum(1 for _ in TASKS.iterdir())
    except OSError:
        return threading.active_count()
