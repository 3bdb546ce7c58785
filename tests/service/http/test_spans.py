"""Spans: of an HTTP exchange, of the planning inside it and of its stages."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Sequence
from typing import Any

import pytest
from opentelemetry.sdk.trace import ReadableSpan
from opentelemetry.sdk.trace.export import SimpleSpanProcessor
from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter
from opentelemetry.trace import SpanContext
from starlette.middleware import Middleware

from anchorflow_client import AnchorRequest
from anchorflow_client.codec import JsonCodec, Payload
from anchorflow_service.http import create_app
from anchorflow_service.observability.spans import Tracing
from anchorflow_service.planning import Arrival, Call, PlanningService

TRACE, PARENT = "0af7651916cd43dd8448eb211c80319c", "b7ad6b7169203331"
JSON = {"Content-Type": "application/json"}


@pytest.fixture
def exporter() -> InMemorySpanExporter:
    return InMemorySpanExporter()


@pytest.fixture
def tracing(exporter: InMemorySpanExporter) -> Tracing:
    return Tracing(SimpleSpanProcessor(exporter))


@pytest.fixture
def service(planning: PlanningService, tracing: Tracing, run: Any) -> Any:
    """The application with traces, running in this process."""
    planning.watch(tracing)
    middleware = [Middleware(tracing.middleware)]
    return run(create_app(planning, endpoints=[tracing], middleware=middleware))


def named(spans: Sequence[ReadableSpan], name: str) -> ReadableSpan:
    (found,) = [span for span in spans if span.name == name]
    return found


def context_of(span: ReadableSpan) -> SpanContext:
    context = span.get_span_context()
    assert context is not None
    return context


def parent_of(span: ReadableSpan) -> int | None:
    return span.parent and span.parent.span_id


def test_a_request_is_a_tree_of_spans(
    service: Any, exporter: InMemorySpanExporter, fields: dict[str, Any]
) -> None:
    assert service.post(fields | {"request_id": "r7"}).status_code == 200
    spans = exporter.get_finished_spans()

    exchange, plan = named(spans, "POST /anchors"), named(spans, "plan")
    assert parent_of(exchange) is None
    assert parent_of(plan) == context_of(exchange).span_id
    assert exchange.attributes is not None
    assert plan.attributes is not None
    assert exchange.attributes["http.response.status_code"] == 200
    assert exchange.attributes["anchorflow.request_id"] == "r7"
    assert plan.attributes["anchorflow.request_id"] == "r7"
    assert plan.attributes["anchorflow.model"] == "lines"
    assert plan.attributes["anchorflow.outcome"] == "ok"

    # The engine of the tests says 1, 2 and 3 ms, one after the other up to the answer.
    ends = []
    for name, ms in (("encode", 1), ("sample", 2), ("refine", 3)):
        stage = named(spans, name)
        assert parent_of(stage) == context_of(plan).span_id
        assert stage.start_time is not None
        assert stage.end_time is not None
        assert stage.end_time - stage.start_time == ms * 1_000_000
        ends += [stage.start_time, stage.end_time]
    assert ends[1:5:2] == ends[2:6:2]
    assert ends[-1] == plan.end_time


def test_the_callers_trace_goes_on(service: Any, exporter: InMemorySpanExporter) -> None:
    headers = {"traceparent": f"00-{TRACE}-{PARENT}-01"}
    service.request("GET", "/v2/health/live", headers=headers)

    span = named(exporter.get_finished_spans(), "GET /v2/health/live")
    assert context_of(span).trace_id == int(TRACE, 16)
    assert parent_of(span) == int(PARENT, 16)

    exporter.clear()
    service.request("GET", "/v2/health/live", headers={"traceparent": "nonsense"})
    assert parent_of(named(exporter.get_finished_spans(), "GET /v2/health/live")) is None


def test_a_refusal_and_a_failure_are_errors(
    service: Any, engine: Any, exporter: InMemorySpanExporter, fields: dict[str, Any]
) -> None:
    service.post(fields | {"num_samples": 0})
    assert named(exporter.get_finished_spans(), "plan").status.description == "invalid_request"

    def fail(_: Any) -> Any:
        raise ZeroDivisionError

    exporter.clear()
    engine.before_answer = fail
    service.post(fields)
    spans = exporter.get_finished_spans()
    assert named(spans, "plan").status.description == "internal"
    exchange = named(spans, "POST /anchors")
    assert exchange.attributes is not None
    assert exchange.attributes["http.response.status_code"] == 500


def test_another_transport_begins_a_trace_of_its_own(
    planning: PlanningService,
    tracing: Tracing,
    exporter: InMemorySpanExporter,
    fields: dict[str, Any],
) -> None:
    planning.watch(tracing)
    codec = JsonCodec()
    payload = codec.encode_request(AnchorRequest.build(**fields))

    async def ask() -> None:
        with planning:
            call = Call(payload, codec, planning.arrival(), "r1", transport="zenoh")
            await planning.answer(call)

    asyncio.run(ask())
    plan = named(exporter.get_finished_spans(), "plan")
    assert parent_of(plan) is None
    assert plan.attributes is not None
    assert plan.attributes["anchorflow.transport"] == "zenoh"


def test_a_collector_that_does_not_answer_keeps_no_service_from_ending(
    exporter: InMemorySpanExporter,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    answers = threading.Event()
    monkeypatch.setattr(exporter, "shutdown", lambda: answers.wait(5))

    async def end() -> None:
        async with Tracing(SimpleSpanProcessor(exporter), sending_s=0.1):
            pass

    asyncio.run(end())
    answers.set()
    assert "the collector did not answer in 0.1 s: what is left of the traces" in caplog.text


def test_the_service_has_a_name_that_the_environment_may_change(
    monkeypatch: pytest.MonkeyPatch, exporter: InMemorySpanExporter
) -> None:
    monkeypatch.setenv("OTEL_SERVICE_NAME", "warehouse")
    for name, expected in (("warehouse", "warehouse"), (None, "anchorflow")):
        if name is None:
            monkeypatch.delenv("OTEL_SERVICE_NAME")
        tracing = Tracing(SimpleSpanProcessor(exporter))
        tracing.ended(Call(Payload(b""), JsonCodec(), Arrival(), "r1"), "ok")
        resource = exporter.get_finished_spans()[-1].resource
        assert resource.attributes["service.name"] == expected
