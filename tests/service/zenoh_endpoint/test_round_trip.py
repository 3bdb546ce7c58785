"""The real client against the real endpoint over loopback."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

from anchorflow_client import (
    AnchorBatch,
    AnchorRequest,
    Cancellation,
    Cancelled,
    ConnectionFailed,
    InternalError,
    InvalidRequest,
    Overloaded,
    TimedOut,
    UnknownModel,
)
from anchorflow_client.contract.batch import ARRAY_DTYPES
from anchorflow_client.zenoh_client import ZenohAnchorClient, ZenohSettings
from anchorflow_service.planning import Call, Observer, PlanningService, ServiceLimits

PATIENCE_S = 20


class Outcomes(Observer):
    """What became of every call."""

    def __init__(self) -> None:
        self.seen: list[str] = []

    def ended(self, call: Call, outcome: str) -> None:  # noqa: ARG002
        self.seen.append(outcome)


def test_the_answer_is_what_the_engine_planned(
    client: ZenohAnchorClient, engine: Any, fields: dict[str, Any]
) -> None:
    anchors = client.plan(**fields)

    planned = engine.plan(engine.seen[0])
    for name in ARRAY_DTYPES:
        np.testing.assert_array_equal(getattr(anchors, name), getattr(planned, name))
    assert (anchors.dt, anchors.seed, anchors.model) == (planned.dt, 1, engine.card.id)
    assert set(anchors.timing_ms) == {"queue", "encode", "sample", "refine", "total"}


def test_a_service_tells_what_it_is(client: ZenohAnchorClient, engine: Any) -> None:
    assert client.live()
    assert client.ready()
    cards = client.models()
    assert [card.name for card in cards] == ["lines", "bows"]
    assert cards[0] == engine.card


def test_another_model_answers_by_name(client: ZenohAnchorClient, fields: dict[str, Any]) -> None:
    assert client.plan(**fields, model="bows").model.name == "bows"
    with pytest.raises(UnknownModel, match=r"is served \(bows, lines\), got 'nobody'"):
        client.plan(**fields, model="nobody")


def test_the_request_id_is_echoed(client: ZenohAnchorClient, fields: dict[str, Any]) -> None:
    assert client.plan(**fields, request_id="r1").request_id == "r1"
    assert len(client.plan(**fields).request_id or "") == 32


def test_refusals_are_those_of_http(client: ZenohAnchorClient, fields: dict[str, Any]) -> None:
    with pytest.raises(InvalidRequest, match="expected 2 m/s, which lines") as caught:
        client.plan(**fields, v_max=9.0)
    assert (caught.value.field, caught.value.http_status) == ("v_max", 422)


def test_a_failure_is_internal_and_tells_nothing(
    client: ZenohAnchorClient, engine: Any, fields: dict[str, Any], caplog: Any
) -> None:
    def explode(_: AnchorBatch) -> AnchorBatch:
        raise ZeroDivisionError("secret detail")

    engine.before_answer = explode

    with pytest.raises(InternalError, match="the log tells of request r7") as caught:
        client.plan(**fields, request_id="r7")
    assert "secret" not in str(caught.value)
    assert "request r7 failed" in caplog.text
    assert "secret detail" in caplog.text


def test_the_service_is_told_the_time_that_is_left(
    client: ZenohAnchorClient, engine: Any, fields: dict[str, Any]
) -> None:
    client.plan(**fields, budget_ms=60_000)
    assert 50_000 < engine.seen[-1].budget_ms < 60_000

    client.plan(**fields)  # no budget: the time after which this client gives up
    assert 10_000 < engine.seen[-1].budget_ms < 20_000


def test_a_patience_beyond_any_budget_is_sent_as_the_longest(
    replica: Any, endpoint: str, engine: Any, fields: dict[str, Any]
) -> None:
    assert replica.replica == "a"
    with ZenohAnchorClient(endpoint, timeout_s=1e6) as client:
        client.plan(**fields)

    assert engine.seen[-1].budget_ms == 1e7


def test_a_budget_bounds_the_wait(
    client: ZenohAnchorClient, gate: Any, fields: dict[str, Any]
) -> None:
    assert client.live()

    # The gate stays shut: who waited on would hear of that, 20 s later, and not of the time.
    with pytest.raises(TimedOut, match="no answer within 1000 ms; asked a"):
        client.plan(**fields, budget_ms=1000)
    gate.opened.set()


def test_a_request_can_be_taken_back(
    client: ZenohAnchorClient, engine: Any, gate: Any, fields: dict[str, Any]
) -> None:
    cancellation = Cancellation()
    request = AnchorRequest.from_fields(fields)
    with ThreadPoolExecutor(1) as executor:
        asked = executor.submit(client.plan_request, request, cancellation=cancellation)
        assert gate.reached.wait(PATIENCE_S)
        cancellation.cancel()
        with pytest.raises(Cancelled):
            asked.result(PATIENCE_S)
    gate.opened.set()

    with pytest.raises(Cancelled):
        client.plan_request(request, cancellation=cancellation)
    assert client.plan(**fields).seed == 1
    assert len(engine.seen) == 2  # what was taken back before was never sent


def test_what_nobody_waits_for_is_dropped_by_the_services_own_clock(
    client: ZenohAnchorClient,
    endpoint: str,
    planning: PlanningService,
    engine: Any,
    gate: Any,
    fields: dict[str, Any],
    until: Any,
) -> None:
    """Zenoh does not tell it of a client that gave up, was killed, or took its request back."""
    cancellation = Cancellation()
    request = AnchorRequest.from_fields(fields)
    with ThreadPoolExecutor(2) as executor, ZenohAnchorClient(endpoint, timeout_s=1) as hasty:
        occupied = executor.submit(client.plan_request, request)
        assert gate.reached.wait(PATIENCE_S)
        taken_back = executor.submit(hasty.plan_request, request, cancellation=cancellation)
        until(lambda: planning.queue.in_flight == 2)
        cancellation.cancel()
        with pytest.raises(Cancelled):
            taken_back.result(PATIENCE_S)
        with pytest.raises(TimedOut):
            hasty.plan_request(request)
        until(lambda: planning.queue.in_flight == 1)  # without a budget it would wait for its turn
        assert not occupied.done()
        gate.opened.set()
        assert occupied.result(PATIENCE_S).seed == 1

    assert len(engine.seen) == 1


def test_a_newer_request_of_a_robot_ends_the_one_that_was_taken_back(
    client: ZenohAnchorClient,
    planning: PlanningService,
    gate: Any,
    fields: dict[str, Any],
    until: Any,
) -> None:
    outcomes = Outcomes()
    planning.watch(outcomes)
    cancellation = Cancellation()
    request = AnchorRequest.from_fields(fields | {"robot_id": "r1"})
    with ThreadPoolExecutor(2) as executor:
        occupied = executor.submit(lambda: client.plan(**fields))
        assert gate.reached.wait(PATIENCE_S)
        taken_back = executor.submit(client.plan_request, request, cancellation=cancellation)
        until(lambda: planning.queue.in_flight == 2)
        cancellation.cancel()
        with pytest.raises(Cancelled):
            taken_back.result(PATIENCE_S)
        newer = executor.submit(client.plan_request, request)
        until(lambda: outcomes.seen == ["superseded"])
        gate.opened.set()
        assert newer.result(PATIENCE_S).seed == occupied.result(PATIENCE_S).seed == 1


def test_closing_takes_back_what_waits(
    client: ZenohAnchorClient, gate: Any, fields: dict[str, Any]
) -> None:
    with ThreadPoolExecutor(1) as executor:
        asked = executor.submit(lambda: client.plan(**fields))
        assert gate.reached.wait(PATIENCE_S)
        client.close()
        with pytest.raises(Cancelled):
            asked.result(PATIENCE_S)
    with pytest.raises(ConnectionFailed, match="closed"):
        client.plan(**fields)


def test_threads_may_share_a_client(client: ZenohAnchorClient, fields: dict[str, Any]) -> None:
    with ThreadPoolExecutor(8) as executor:
        answers = list(
            executor.map(lambda seed: client.plan(**fields | {"seed": seed}).seed, range(40))
        )

    assert answers == list(range(40))


def test_nobody_listens(endpoint: str, fields: dict[str, Any]) -> None:
    with ZenohAnchorClient(endpoint) as client:
        assert not client.live()
        assert not client.ready()
        with pytest.raises(ConnectionFailed, match=f"nobody listens at {endpoint}"):
            client.plan(**fields)


def test_a_router_without_a_service(start: Any, endpoint: str, fields: dict[str, Any]) -> None:
    start("router.py", endpoint)
    with ZenohAnchorClient(endpoint) as client:
        assert not client.live()
        with pytest.raises(ConnectionFailed, match="no service is alive there"):
            client.plan(**fields)


def test_a_peer_that_is_connected_to_nobody(endpoint: str, fields: dict[str, Any]) -> None:
    settings = ZenohSettings(mode="peer", connect=(endpoint,))
    with ZenohAnchorClient(settings) as client, pytest.raises(ConnectionFailed, match="nobody"):
        client.plan(**fields)


def test_the_queue_is_the_services(
    serve: Any, endpoint: str, engine: Any, gate: Any, fields: Any
) -> None:
    """One request too many is refused over zenoh, however the others came."""
    service = PlanningService(
        {"lines": engine}, default="lines", limits=ServiceLimits(max_waiting=0, threads=1)
    )
    serve(ZenohSettings(listen=(endpoint,)), service)
    with ThreadPoolExecutor(1) as executor, ZenohAnchorClient(endpoint) as client:
        occupied = executor.submit(lambda: client.plan(**fields))
        assert gate.reached.wait(PATIENCE_S)
        with pytest.raises(Overloaded, match="try again in 1 s") as caught:
            client.plan(**fields)
        assert caught.value.retry_after_s == 1
        gate.opened.set()
        assert occupied.result(PATIENCE_S).seed == 1
