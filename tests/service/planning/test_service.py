"""The way from bytes to bytes that all transports share, without any of them."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from anchorflow_client import (
    AnchorRequest,
    DeadlineExceeded,
    InvalidRequest,
    JsonCodec,
    OipCodec,
    Payload,
    UnknownModel,
)
from anchorflow_client.contract import resolve_for_card
from anchorflow_service.planning import Call, PlanningService
from anchorflow_service.planning.service import QUICK_BYTES

CODEC = OipCodec()
PATIENCE_S = 20


@pytest.fixture
def planning(planning: PlanningService) -> Iterator[PlanningService]:
    with planning:
        yield planning


def call(planning: PlanningService, fields: dict[str, Any], **beside: Any) -> Call:
    """A call in binary, with what its transport says beside it."""
    payload = CODEC.encode_request(AnchorRequest.from_fields(fields))
    return Call(payload, CODEC, planning.arrival(), "drawn", **beside)


Ask = Callable[..., Any]


@pytest.fixture
def ask(planning: PlanningService, fields: dict[str, Any]) -> Ask:
    """Answers a call in binary with some fields changed, and what stands beside its bytes."""

    def ask(changes: dict[str, Any], **beside: Any) -> Any:
        return CODEC.decode_answer(
            asyncio.run(planning.answer(call(planning, fields | changes, **beside)))
        )

    return ask


def test_the_same_bytes_in_give_the_same_bytes_out(engine: Any, fields: dict[str, Any]) -> None:
    """What differs between two answers is the time they took; here it stands still."""
    with PlanningService({"lines": engine}, default="lines", clock=lambda: 7.0) as planning:
        first, second = (
            asyncio.run(planning.answer(call(planning, fields | {"seed": 3}))) for _ in range(2)
        )

    assert first == second
    assert CODEC.decode_answer(first).timing_ms["total"] == 0.0


def test_the_address_may_name_the_model(ask: Ask) -> None:
    assert ask({}).model.name == "lines"
    assert ask({}, model="bows").model.name == "bows"
    assert ask({"model": "bows"}, model="bows").model.name == "bows"
    with pytest.raises(InvalidRequest, match="model: expected bows, as the address says"):
        ask({"model": "lines"}, model="bows")
    with pytest.raises(UnknownModel, match="'nobody'"):
        ask({}, model="nobody")


def test_the_requests_own_id_rules_also_when_it_is_refused(
    planning: PlanningService, ask: Ask, fields: dict[str, Any]
) -> None:
    assert ask({}).request_id == "drawn"
    assert ask({"request_id": "own"}).request_id == "own"
    refused = call(planning, fields | {"request_id": "own", "v_max": 9.0})
    with pytest.raises(InvalidRequest, match="v_max"):
        asyncio.run(planning.answer(refused))
    assert refused.request_id == "own"


def test_a_budget_beside_the_bytes_is_the_newer_one(ask: Ask) -> None:
    with pytest.raises(DeadlineExceeded, match="within 1e-06 ms"):
        ask({"budget_ms": 60_000}, budget_ms=1e-6)
    assert ask({"budget_ms": 1e-6}, budget_ms=60_000)


def test_the_default_must_be_served(engine: Any) -> None:
    with pytest.raises(ValueError, match="'b' is none of"):
        PlanningService({"a": engine}, default="b")


def test_what_takes_long_to_read_is_read_off_the_event_loop(
    planning: PlanningService, fields: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Health has to be answered meanwhile; a short binary request would lose by the way there."""
    threads: list[str] = []

    def resolve(*given: Any) -> Any:
        threads.append(threading.current_thread().name.partition("_")[0])
        return resolve_for_card(*given)

    monkeypatch.setattr("anchorflow_service.planning.service.resolve_for_card", resolve)
    asyncio.run(planning.answer(call(planning, fields)))
    loop, words = threading.current_thread().name, JsonCodec()
    payload = words.encode_request(AnchorRequest.from_fields(fields))
    asyncio.run(planning.answer(Call(payload, words, planning.arrival(), "json")))
    monkeypatch.setattr("anchorflow_service.planning.service.QUICK_BYTES", 100)
    asyncio.run(planning.answer(call(planning, fields)))

    assert threads == [loop, "reading", "reading-large"]


class HeldCodec(JsonCodec):
    """Reads long bodies once it may."""

    def __init__(self) -> None:
        super().__init__()
        self.reached, self.opened = threading.Event(), threading.Event()

    def decode_request(self, payload: Payload) -> AnchorRequest:
        if len(payload.body) > QUICK_BYTES:
            self.reached.set()
            assert self.opened.wait(PATIENCE_S)
        return super().decode_request(payload)


@pytest.mark.anyio
async def test_a_small_request_does_not_wait_behind_a_large_one(
    planning: PlanningService, fields: dict[str, Any]
) -> None:
    codec = HeldCodec()
    small = codec.encode_request(AnchorRequest.from_fields(fields))
    large = Payload(small.body.ljust(QUICK_BYTES + 1))

    def asked(payload: Payload) -> Call:
        return Call(payload, codec, planning.arrival(), "json")

    behind = asyncio.create_task(planning.answer(asked(large)))
    try:
        assert await asyncio.to_thread(codec.reached.wait, PATIENCE_S)
        await asyncio.wait_for(planning.answer(asked(small)), PATIENCE_S)
        assert not behind.done()
    finally:
        codec.opened.set()
    assert await behind
