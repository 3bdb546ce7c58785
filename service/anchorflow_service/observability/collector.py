"""What Prometheus reads off a service at the moment of asking."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

from prometheus_client.core import GaugeMetricFamily, InfoMetricFamily, Metric
from prometheus_client.registry import Collector

from anchorflow_service.planning import PlanningService

TASKS = Path("/proc/self/task")
"""A folder for each thread of this process, where the system is Linux."""


class ServiceCollector(Collector):
    """Readiness, load, threads and bundles."""

    def __init__(self, service: PlanningService) -> None:
        self._service = service

    def collect(self) -> Iterator[Metric]:
        """One family after the other."""
        queue = self._service.queue
        yield GaugeMetricFamily(
            "anchorflow_ready", "1 while requests are taken.", float(self._service.is_ready)
        )
        yield GaugeMetricFamily(
            "anchorflow_in_flight", "Requests that wait or are planned.", queue.in_flight
        )
        yield GaugeMetricFamily(
            "anchorflow_oldest_wait_seconds",
            "Age of the first in the queue; 0 where nobody waits.",
            queue.oldest_wait_s,
        )
        yield GaugeMetricFamily("anchorflow_workers", "Engine calls at a time.", queue.num_lanes)
        yield GaugeMetricFamily(
            "anchorflow_threads", "Threads of the process, the engines' own included.", threads()
        )
        yield self._bundles()

    def _bundles(self) -> Metric:
        family = InfoMetricFamily("anchorflow_bundle", "Bundles that are served.")
        for card in self._service.engines.cards():
            labels = {"model": card.name, "version": card.version, "sha256": card.sha256}
            family.add_metric([], labels)
        return family


def threads() -> int:
    """Of this process; without Linux's list of them, those that Python knows."""
    try:
        return sum(1 for _ in TASKS.iterdir())
    except OSError:
        return threading.active_count()
