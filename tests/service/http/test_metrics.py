"""Metrics of the application and of other transports, and the dashboard that shows them."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from prometheus_client.parser import text_string_to_metric_families

from anchorflow_service.observability.metrics import (
    SHARED_FOLDER,
    SharedFolderError,
    reserve_shared_files,
)
from anchorflow_service.planning import PlanningService

Samples = dict[tuple[str, frozenset[tuple[str, str]]], float]


def samples_of(text: str) -> Samples:
    return {
        (sample.name, frozenset(sample.labels.items())): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def value(samples: Samples, name: str, **labels: str) -> float:
    return samples.get((name, frozenset(labels.items())), 0.0)


def scraped(service: Any) -> Samples:
    answer = service.request("GET", "/metrics")
    assert answer.headers["content-type"] == "text/plain; version=0.0.4; charset=utf-8"
    return samples_of(answer.text)


def requests(samples: Samples, model: str, outcome: str) -> float:
    return value(
        samples, "anchorflow_requests_total", transport="http", model=model, outcome=outcome
    )


def test_an_answer_is_counted_with_its_times(service: Any, fields: dict[str, Any]) -> None:
    for _ in range(3):
        assert service.post(fields).status_code == 200

    samples = scraped(service)

    assert requests(samples, "lines", "ok") == 3
    assert value(samples, "anchorflow_request_seconds_count", transport="http") == 3
    assert value(samples, "anchorflow_queue_seconds_count") == 3
    assert value(samples, "anchorflow_batch_requests_count") == 3
    assert value(samples, "anchorflow_batch_requests_sum") == 3
    # The engine of the tests says 1, 2 and 3 ms.
    for stage, ms in (("encode", 1.0), ("sample", 2.0), ("refine", 3.0)):
        total = value(samples, "anchorflow_stage_seconds_sum", stage=stage)
        assert total == pytest.approx(3 * ms / 1e3)
    posted = value(samples, "anchorflow_http_responses_total", route="/anchors", status="200")
    assert posted == 3


@pytest.mark.parametrize(
    ("change", "model", "code"),
    [
        ({"budget_ms": 0.001}, "lines", "deadline_exceeded"),
        ({"num_samples": 0}, "", "invalid_request"),
        ({"model": "nobody"}, "", "unknown_model"),
        ({"horizon_s": 5.0}, "lines", "invalid_request"),
    ],
)
def test_a_refusal_is_counted_by_its_code(
    service: Any, fields: dict[str, Any], change: dict[str, Any], model: str, code: str
) -> None:
    assert service.post(fields | change).status_code != 200

    samples = scraped(service)
    assert requests(samples, model, code) == 1
    assert value(samples, "anchorflow_queue_seconds_count") == 0


def test_a_failure_is_internal(service: Any, engine: Any, fields: dict[str, Any]) -> None:
    def fail(_: Any) -> Any:
        raise ZeroDivisionError

    engine.before_answer = fail
    service.post(fields)

    samples = scraped(service)
    assert requests(samples, "lines", "internal") == 1
    answered = value(samples, "anchorflow_http_responses_total", route="/anchors", status="500")
    assert answered == 1


def test_callers_cannot_invent_labels(service: Any, fields: dict[str, Any]) -> None:
    before = len(scraped(service))
    for number in range(20):
        service.post(fields | {"model": f"invented-{number}"})
        service.request("GET", f"/invented/{number}")

    text = service.request("GET", "/metrics").text
    assert "invented" not in text
    routes = value(samples_of(text), "anchorflow_http_responses_total", route="other", status="404")
    assert routes == 20
    assert len(samples_of(text)) < before + 100


def test_a_path_cannot_begin_a_line_of_the_log(
    service: Any, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level("INFO", "anchorflow_service.access"):
        service.request("GET", "/a%0AERROR%20all%20is%20lost")

    (record,) = caplog.records
    assert record.getMessage().startswith("GET /a%0AERROR%20all%20is%20lost 404 in ")


def test_a_path_with_a_name_in_it_is_one_route(service: Any) -> None:
    for name in ("lines", "bows"):
        assert service.request("GET", f"/v2/models/{name}/ready").status_code == 200

    samples = scraped(service)
    route = "/v2/models/{name}/ready"
    assert value(samples, "anchorflow_http_responses_total", route=route, status="200") == 2


def test_bundles_load_and_threads_stand_as_they_are(service: Any, planning: Any) -> None:
    samples = scraped(service)

    for model in ("lines", "bows"):
        labels = {"model": model, "version": "1.2.3", "sha256": "ab" * 32}
        assert value(samples, "anchorflow_bundle_info", **labels) == 1
    assert value(samples, "anchorflow_ready") == 1
    assert value(samples, "anchorflow_in_flight") == 0
    assert value(samples, "anchorflow_workers") == planning.queue.num_lanes
    assert value(samples, "anchorflow_threads") > 1
    assert value(samples, "process_open_fds") > 1

    planning.leave()
    assert value(scraped(service), "anchorflow_ready") == 0


def test_the_age_of_the_oldest_in_the_queue_is_seen(
    service: Any,
    gate: Any,
    planning: PlanningService,
    fields: dict[str, Any],
    background: ThreadPoolExecutor,
    until: Any,
) -> None:
    def oldest_wait_s() -> float:
        return value(scraped(service), "anchorflow_oldest_wait_seconds")

    assert planning.queue.num_lanes == 1
    first = background.submit(service.post, fields)
    assert gate.reached.wait(20)
    second = background.submit(service.post, fields)
    until(oldest_wait_s)
    waited_s = oldest_wait_s()
    until(lambda: oldest_wait_s() > waited_s)
    assert value(scraped(service), "anchorflow_in_flight") == 2

    gate.opened.set()
    assert [each.result(20).status_code for each in (first, second)] == [200, 200]
    assert oldest_wait_s() == 0


def test_without_room_for_shared_counts_a_worker_does_not_start(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A disk that becomes full later would kill the process."""
    (tmp_path / "file").touch()
    monkeypatch.setenv(SHARED_FOLDER, str(tmp_path / "file"))

    with pytest.raises(SharedFolderError, match="file: cannot be written: File exists"):
        reserve_shared_files()


# The Grafana dashboard

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
    for name, own in scraped(service):
        labels.setdefault(name, set()).update(label for label, _ in own)
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
    suffix = re.compile(r"_(total|bucket|sum|count|created)$")
    own = {suffix.sub("", name) for name in exposed if name.startswith("anchorflow_")}
    shown = {suffix.sub("", name) for query in queries() for name in METRIC.findall(query)}

    assert own <= shown
