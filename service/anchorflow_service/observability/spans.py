"""OpenTelemetry traces, sent over OTLP (HTTP): a span per HTTP exchange and per planning call.

Only `--traces` of `anchorflow serve` imports this module.
"""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections.abc import Mapping

from opentelemetry.context import Context, attach, detach
from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
from opentelemetry.propagate import extract
from opentelemetry.sdk.resources import SERVICE_NAME, OTELResourceDetector, Resource
from opentelemetry.sdk.trace import SpanProcessor, TracerProvider
from opentelemetry.sdk.trace.export import BatchSpanProcessor
from opentelemetry.trace import SpanKind, StatusCode, Tracer, set_span_in_context
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from anchorflow_service.planning import ANSWERED, Call, Observer

STAGES = ("queue", "encode", "sample", "refine")
NS_PER_MS = 1_000_000
SENDING_S = 3.0
"""Limit on sending the rest at the end; OpenTelemetry waits 10 s for an unreachable collector."""

logger = logging.getLogger(__name__)


class Tracing(Observer):
    """Spans of one service; the end of its `async with` block sends the rest.

    Args:
        processor: takes the spans.
        sending_s: longest wait for the rest; then it is dropped.
    """

    def __init__(self, processor: SpanProcessor, *, sending_s: float = SENDING_S) -> None:
        self._sending_s = sending_s
        named = Resource({SERVICE_NAME: "anchorflow"}).merge(OTELResourceDetector().detect())
        self._provider = TracerProvider(resource=named, shutdown_on_exit=False)
        self._provider.add_span_processor(processor)
        self._tracer = self._provider.get_tracer("anchorflow_service")

    def middleware(self, app: ASGIApp) -> ASGIApp:
        """Wrap the application in a span for each HTTP exchange."""
        return TracedExchanges(app, tracer=self._tracer)

    async def __aenter__(self) -> Tracing:
        return self

    async def __aexit__(self, *_: object) -> None:
        # A daemon thread, so that the process does not wait for it either.
        sending = threading.Thread(target=self._provider.shutdown, daemon=True)
        sending.start()
        await asyncio.to_thread(sending.join, self._sending_s)
        if sending.is_alive():
            logger.warning(
                "the collector did not answer in %g s: what is left of the traces is dropped",
                self._sending_s,
            )

    def ended(self, call: Call, outcome: str) -> None:
        """Record a span for the call with one for each stage, under the current span.

        The durations are known only now, so the spans get their start times afterwards.
        """
        now = time.time_ns()
        arrived = now - round(call.arrival.elapsed_ms * NS_PER_MS)
        attributes = {
            "anchorflow.request_id": call.request_id,
            "anchorflow.transport": call.transport,
            "anchorflow.outcome": outcome,
        }
        if call.model_id:
            attributes["anchorflow.model"] = call.model_id.name
            attributes["anchorflow.model.version"] = call.model_id.version
        span = self._tracer.start_span("plan", attributes=attributes, start_time=arrived)
        if outcome != ANSWERED:
            span.set_status(StatusCode.ERROR, outcome)
        if call.timing_ms:
            self._stages(set_span_in_context(span), call.timing_ms, end=now)
        span.end(now)

    def _stages(self, parent: Context, timing_ms: Mapping[str, float], *, end: int) -> None:
        # Place the stages backwards from the end: how long decoding took before them is unknown.
        lengths = [round(timing_ms.get(stage, 0.0) * NS_PER_MS) for stage in STAGES]
        start = end - sum(lengths)
        for stage, length in zip(STAGES, lengths, strict=True):
            span = self._tracer.start_span(stage, context=parent, start_time=start)
            start += length
            span.end(start)


class TracedExchanges:
    """Middleware: a span for each HTTP exchange, under the caller's if its headers name one."""

    def __init__(self, app: ASGIApp, *, tracer: Tracer) -> None:
        self._app = app
        self._tracer = tracer

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on inside a span."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        parent = extract(dict(Headers(scope=scope)))
        attributes = {"http.request.method": scope["method"], "url.path": scope["path"]}
        span = self._tracer.start_span(
            scope["method"], context=parent, kind=SpanKind.SERVER, attributes=attributes
        )

        async def send_noted(message: Message) -> None:
            if message["type"] == "http.response.start":
                span.set_attribute("http.response.status_code", message["status"])
            await send(message)

        token = attach(set_span_in_context(span))
        try:
            await self._app(scope, receive, send_noted)
        except Exception as error:
            span.record_exception(error)
            span.set_attribute("http.response.status_code", 500)
            raise
        finally:
            detach(token)
            if route := getattr(scope.get("route"), "path", None):
                span.update_name(f"{scope['method']} {route}")
                span.set_attribute("http.route", route)
            span.set_attribute("anchorflow.request_id", scope["state"]["request_id"])
            span.end()


def tracing_to(endpoint: str) -> Tracing:
    """Send spans to an OTLP collector, such as http://127.0.0.1:4318/v1/traces.

    OpenTelemetry's environment variables (OTEL_SERVICE_NAME, OTEL_EXPORTER_OTLP_HEADERS, …) set
    the rest.
    """
    return Tracing(BatchSpanProcessor(OTLPSpanExporter(endpoint=endpoint)))
