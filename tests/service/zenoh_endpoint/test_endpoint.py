"""The endpoint as any zenoh program sees it: keys, attachments, errors, joining and leaving."""

from __future__ import annotations

import json
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import pytest
import zenoh
from anyio.from_thread import start_blocking_portal

from anchorflow_client import AnchorBatch, AnchorRequest, InvalidRequest, OipCodec, Payload
from anchorflow_client.zenoh_client import ZenohSettings
from anchorflow_client.zenoh_client.session import open_session
from anchorflow_service.observability.metrics import Metrics
from anchorflow_service.planning import PlanningService, ServiceLimits
from anchorflow_service.zenoh_endpoint import ZenohEndpoint

CODEC = OipCodec()
LINES = "anchorflow/v1/anchors/lines"
PATIENCE_S = 20


@pytest.fixture
def session(replica: ZenohEndpoint, endpoint: str) -> Iterator[zenoh.Session]:
    """Open a session of another program on replica "a"'s network."""
    assert replica.replica == "a"
    settings = ZenohSettings(mode="client", connect=(endpoint,))
    with open_session(settings) as session:
        yield session


def ask(
    session: zenoh.Session,
    key: str,
    fields: dict[str, Any],
    *,
    attachment: dict[str, Any] | bytes | None = None,
    payload: bytes | None = None,
) -> list[zenoh.Reply]:
    """Return all replies to a request, by default with a valid attachment."""
    sent = CODEC.encode_request(AnchorRequest.from_fields(fields))
    if attachment is None:
        attachment = {"header_length": sent.header_length, "request_id": "r1"}
    if isinstance(attachment, dict):
        attachment = json.dumps(attachment).encode()
    replies = session.get(
        key,
        payload=sent.body if payload is None else payload,
        attachment=attachment,
        timeout=float(PATIENCE_S),
    )
    return list(replies)


def answer_of(reply: zenoh.Reply) -> tuple[AnchorBatch, dict[str, Any]]:
    """Return an answer and its attachment."""
    assert reply.ok is not None
    assert reply.ok.attachment is not None
    attachment = json.loads(reply.ok.attachment.to_bytes())
    payload = Payload(reply.ok.payload.to_bytes(), attachment["header_length"])
    return CODEC.decode_answer(payload), attachment


def error_of(replies: list[zenoh.Reply]) -> dict[str, Any]:
    """Return the contract's error in the only reply."""
    (reply,) = replies
    assert reply.err is not None
    assert str(reply.err.encoding) == "application/json"
    return json.loads(reply.err.payload.to_bytes())["error"]


@pytest.mark.parametrize("key", [LINES, "anchorflow/v1/replica/a/anchors/lines"])
def test_a_query_is_answered_on_both_keys(
    session: zenoh.Session, fields: dict[str, Any], key: str
) -> None:
    (reply,) = ask(session, key, fields)

    batch, attachment = answer_of(reply)
    assert reply.ok is not None
    assert str(reply.ok.key_expr) == key
    assert str(reply.ok.encoding) == "application/octet-stream"
    assert (batch.model.name, batch.seed, batch.request_id) == ("lines", 1, "r1")
    assert (attachment["request_id"], attachment["replica"]) == ("r1", "a")
    assert set(attachment["load"]) == {"in_flight", "workers", "mean_service_ms"}
    assert attachment["load"]["in_flight"] == 0  # itself not counted: it is answered


def test_a_key_with_a_wildcard_reaches_every_model(
    session: zenoh.Session, fields: dict[str, Any]
) -> None:
    replies = ask(session, "anchorflow/v1/anchors/*", fields)

    answered = {str(reply.ok.key_expr): answer_of(reply)[0] for reply in replies if reply.ok}
    assert {key: batch.model.name for key, batch in answered.items()} == {
        LINES: "lines",
        "anchorflow/v1/anchors/bows": "bows",
    }


def test_its_info_holds_its_cards_and_its_load(session: zenoh.Session, engine: Any) -> None:
    (reply,) = session.get("anchorflow/v1/replica/*/info", timeout=float(PATIENCE_S))

    assert reply.ok is not None
    assert str(reply.ok.key_expr) == "anchorflow/v1/replica/a/info"
    info = json.loads(reply.ok.payload.to_bytes())
    assert (info["replica"], info["ready"]) == ("a", True)
    assert info["load"]["in_flight"] == 0
    assert info["load"]["mean_service_ms"] == 0.0
    assert info["load"]["workers"] >= 1
    assert [card["name"] for card in info["models"]] == ["lines", "bows"]
    assert info["models"][0]["sha256"] == engine.card.sha256


BAD_ATTACHMENTS: dict[str, tuple[Any, str]] = {
    "none": (b"", "attachment"),
    "no json": (b"{", "attachment"),
    "unknown field": ({"header_length": 64, "robot": 1}, "attachment.robot"),
    "length beyond the body": ({"header_length": 2**50}, "header_length"),
    "no header": ({"header_length": 4}, "header"),
    "another model than the key's": (None, "model"),
}
"""One of each reader; `tests/client/test_zenoh_messages.py` has more of attachments."""


@pytest.mark.parametrize(("attachment", "field"), BAD_ATTACHMENTS.values(), ids=BAD_ATTACHMENTS)
def test_a_bad_query_is_refused_by_name(
    session: zenoh.Session, fields: dict[str, Any], attachment: Any, field: str
) -> None:
    model = {"model": "bows"} if field == "model" else {}
    payload = b"\0" * 8 if field == "header" else None

    replies = ask(session, LINES, fields | model, attachment=attachment, payload=payload)

    error = error_of(replies)
    assert (error["code"], error["field"]) == ("invalid_request", field)
    assert field in error["message"]
    assert ask(session, LINES, fields)[0].ok is not None


def test_the_attachments_budget_overrides_the_bodys(
    session: zenoh.Session, fields: dict[str, Any]
) -> None:
    sent = CODEC.encode_request(AnchorRequest.from_fields(fields | {"budget_ms": 60_000}))
    attachment = {"header_length": sent.header_length, "budget_ms": 1e-6}

    error = error_of(ask(session, LINES, fields, attachment=attachment, payload=sent.body))

    assert (error["code"], error["field"]) == ("deadline_exceeded", "budget_ms")


def test_a_body_over_the_limit_is_refused(
    serve: Any, endpoint: str, engine: Any, fields: dict[str, Any]
) -> None:
    limits = ServiceLimits(max_body_bytes=100)
    service = PlanningService({"lines": engine}, default="lines", limits=limits)
    serve(ZenohSettings(listen=(endpoint,)), service)
    with open_session(ZenohSettings(mode="client", connect=(endpoint,))) as session:
        error = error_of(ask(session, LINES, fields))

    assert (error["code"], error["field"]) == ("too_large", "body")
    assert "at most 100 bytes" in error["message"]


def test_behind_a_router_replicas_of_one_key_get_one_query_each(
    start_router: Any, serve: Any, endpoint: str, engine: Any, fields: dict[str, Any]
) -> None:
    """Complete queryables: a query runs once, not everywhere."""
    start_router()
    at_router = ZenohSettings(mode="client", connect=(endpoint,))
    for name in "ab":
        service = PlanningService({"lines": engine}, default="lines")
        serve(at_router, service, replica=name)
    with open_session(at_router) as session:
        replies = ask(session, LINES, fields)

    assert len(replies) == 1
    assert len(engine.seen) == 1


def test_a_service_that_leaves_answers_the_pending_requests_and_is_gone(
    planning: PlanningService, gate: Any, endpoint: str, fields: dict[str, Any]
) -> None:
    settings = ZenohSettings(mode="client", connect=(endpoint,))
    with start_blocking_portal() as portal, planning, ThreadPoolExecutor(2) as executor:
        joined = ZenohEndpoint(planning, open_session(ZenohSettings(listen=(endpoint,))))
        portal.call(joined.__aenter__)
        with open_session(settings) as session:
            asked = executor.submit(ask, session, LINES, fields)
            assert gate.reached.wait(PATIENCE_S)
            leaving = executor.submit(portal.call, joined.__aexit__, None, None, None)
            gate.opened.set()
            assert answer_of(asked.result(PATIENCE_S)[0])[0].seed == 1
            leaving.result(PATIENCE_S)
            assert ask(session, LINES, fields) == []


def test_a_model_name_that_is_not_allowed_in_a_key_is_refused(engine: Any, endpoint: str) -> None:
    service = PlanningService(
        {"a/b": type(engine)(replace(engine.card, name="a/b"))}, default="a/b"
    )
    with (
        open_session(ZenohSettings(listen=(endpoint,))) as session,
        pytest.raises(InvalidRequest, match="model: expected a name without spaces"),
    ):
        ZenohEndpoint(service, session)


def test_queries_are_counted_beside_https_requests(
    planning: PlanningService, session: zenoh.Session, fields: dict[str, Any]
) -> None:
    """Those that are refused before they are read, too."""
    metrics = Metrics(planning)
    too_large = bytes(planning.limits.max_body_bytes + 1)

    assert ask(session, LINES, fields)[0].ok is not None
    for changes, sent in (
        ({"horizon_s": 5.0}, {}),
        ({}, {"payload": too_large, "attachment": b'{"header_length": 9}'}),
        ({}, {"payload": b"", "attachment": b"no JSON"}),
    ):
        error_of(ask(session, LINES, fields | changes, **sent))

    text = metrics.render().decode()
    for model, outcome in (
        ("lines", "ok"),
        ("lines", "invalid_request"),
        ("", "too_large"),
        ("", "invalid_request"),
    ):
        labels = f'model="{model}",outcome="{outcome}",transport="zenoh"'
        assert f"anchorflow_requests_total{{{labels}}} 1.0" in text
    assert 'anchorflow_request_seconds_count{transport="zenoh"} 1.0' in text
