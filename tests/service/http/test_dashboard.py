"""Every query of the Grafana dashboard uses metrics and labels that a service exposes."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from prometheus_client.parser import text_string_to_metric_families

DASHBOARD = Path(__file__).parents[3] / "docker" / "grafana" / "anchorflow.json"
METRIC = re.compile(r"\b(?:anchorflow|process)_\w+")
FROM_PROMETHEUS = {"instance", "job", "le"}


def queries() -> Iterator[str]:
    for panel in json.loads(DASHBOARD.read_text())["panels"]:
        yield from (target["expr"] for target in panel["targets"])


@pytest.fixture
def exposed(service: Any, fields: dict[str, Any]) -> dict[str, set[str]]:
    """Labels by metric, once there has been something to count."""
    assert service.post(fields).status_code == 200
    labels: dict[str, set[str]] = {}
    for family in text_string_to_metric_families(service.request("GET", "/metrics").text):
        for sample in family.samples:
            labels.setdefault(sample.name, set()).update(sample.labels)
    return labels


def test_every_query_finds_its_metrics_and_labels(exposed: dict[str, set[str]]) -> None:
    for query in queries():
        names = METRIC.findall(query)
        assert names, query
        assert set(names) <= set(exposed), query
        grouped = re.findall(r"by \(([^)]*)\)", query)
        asked = {label.strip() for group in grouped for label in group.split(",")}
        asked |= set(re.findall(r"(\w+)\s*(?:=~|!~|!=|=)\s*\"", query))
        had = set().union(*(exposed[name] for name in names))
        assert asked <= had | FROM_PROMETHEUS, query


def test_what_a_service_tells_of_itself_is_shown(exposed: dict[str, set[str]]) -> None:
    """Every metric is on the dashboard."""
    own = {name for name in exposed if name.startswith("anchorflow_")}
    families = {re.sub(r"_(total|bucket|sum|count|created)$", "", name) for name in own}
    shown = {
        re.sub(r"_(total|bucket|sum|count|created)$", "", name)
        for query in queries()
        for name in METRIC.findall(query)
    }

    assert families <= shown
