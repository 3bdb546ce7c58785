"""Zenoh's keys, attachments and replica information."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given, strategies as st

from anchorflow_client import InvalidAnswer, InvalidRequest, ModelCard, zenoh_messages
from anchorflow_client.zenoh_messages import (
    AnswerAttachment,
    Load,
    ReplicaInfo,
    RequestAttachment,
)

BUSY = Load(in_flight=5, workers=2, mean_service_ms=40.0)


def test_a_requests_attachment_is_the_contracts() -> None:
    said = RequestAttachment(header_length=640, request_id="r1", budget_ms=80.0)

    assert json.loads(said.to_bytes()) == {
        "header_length": 640,
        "request_id": "r1",
        "budget_ms": 80.0,
    }
    assert RequestAttachment.from_bytes(said.to_bytes()) == said
    assert RequestAttachment().to_bytes() == b"{}"
    assert RequestAttachment.from_bytes(None) == RequestAttachment()


@given(st.binary(max_size=60) | st.text(max_size=40).map(str.encode))
def test_no_bytes_break_the_readers(data: bytes) -> None:
    for read, error in (
        (RequestAttachment.from_bytes, InvalidRequest),
        (AnswerAttachment.from_bytes, InvalidAnswer),
        (ReplicaInfo.from_bytes, InvalidAnswer),
    ):
        with pytest.raises(error):
            read(data)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"{", ": expected JSON, got text that breaks at position 1 of 1"),
        (b"9" * 5000, ": expected the contract's JSON, got an integer of too many digits"),
        (b"[1]", ": expected an object, got a list of 1"),
        (b"[" * 20_000, ": "),
        (b'{"robot": 1}', ".robot: unknown field"),
        (b'{"header_length": -1}', ".header_length: expected an integer .* got -1"),
        (b'{"header_length": 1.5}', ".header_length: expected an integer .* got 1.5"),
        (b'{"budget_ms": 0}', ".budget_ms: expected .* got 0"),
        (b'{"request_id": 3}', ".request_id: expected a string, got 3"),
    ],
)
def test_what_is_no_requests_attachment_is_refused_by_name(data: bytes, words: str) -> None:
    with pytest.raises(InvalidRequest, match=f"^attachment{words}"):
        RequestAttachment.from_bytes(data)


def test_an_answers_attachment_comes_back() -> None:
    said = AnswerAttachment(640, "r1", "a", BUSY)

    assert AnswerAttachment.from_bytes(said.to_bytes()) == said


@pytest.mark.parametrize(
    "change",
    [
        {"header_length": None},
        {"header_length": -1},
        {"replica": 3},
        {"request_id": None},
        {"load": 3},
        {"load": {"in_flight": -1, "workers": 1, "mean_service_ms": 0}},
        {"load": {"in_flight": 0, "workers": 0, "mean_service_ms": 0}},
        {"load": {"in_flight": 0, "workers": 1, "mean_service_ms": float("nan")}},
        {"load": {}},
    ],
)
def test_an_answers_attachment_is_not_believed(change: dict[str, Any]) -> None:
    said = json.loads(AnswerAttachment(640, "r1", "a", BUSY).to_bytes()) | change

    with pytest.raises(InvalidAnswer):
        AnswerAttachment.from_bytes(json.dumps(said).encode())


def test_a_replica_tells_its_cards(card: ModelCard) -> None:
    info = ReplicaInfo("a", ready=True, load=BUSY, models=(card,), default="lines")

    assert ReplicaInfo.from_bytes(info.to_bytes()) == info


@pytest.mark.parametrize(
    "change", [{"models": None}, {"models": [{}]}, {"replica": ""}, {"default": 3}]
)
def test_what_a_replica_tells_is_not_believed(card: ModelCard, change: dict[str, Any]) -> None:
    told = json.loads(
        ReplicaInfo("a", ready=True, load=BUSY, models=(card,), default="lines").to_bytes()
    )

    with pytest.raises(InvalidAnswer):
        ReplicaInfo.from_bytes(json.dumps(told | change).encode())


def test_a_replica_that_has_not_answered_yet_is_taken_for_another() -> None:
    assert Load(1, 1, 0.0).expected_ms(unknown_ms=30.0) == 60.0
    assert Load(1, 1, 10.0).expected_ms(unknown_ms=30.0) == 20.0


@pytest.mark.parametrize(
    ("load", "more", "expected_ms"),
    [
        (Load(0, 1, 40.0), 0, 40.0),
        (Load(1, 1, 40.0), 0, 80.0),
        (Load(1, 2, 40.0), 0, 40.0),
        (Load(1, 2, 40.0), 1, 60.0),
        (Load(5, 2, 40.0), 0, 120.0),
        (Load(9, 2, 0.0), 0, 0.0),
    ],
)
def test_a_busy_replica_is_expected_to_take_longer(
    load: Load, more: int, expected_ms: float
) -> None:
    assert load.expected_ms(more) == expected_ms


def test_the_keys_are_the_contracts() -> None:
    assert zenoh_messages.anchors_key("flowmp-small") == "anchorflow/v1/anchors/flowmp-small"
    assert zenoh_messages.replica_key("a") == "anchorflow/v1/replica/a"
    assert zenoh_messages.replica_anchors_key("a", "m") == "anchorflow/v1/replica/a/anchors/m"
    assert zenoh_messages.info_key("a") == "anchorflow/v1/replica/a/info"


def test_a_token_names_its_replica() -> None:
    assert zenoh_messages.replica_of(zenoh_messages.replica_key("a1")) == "a1"


@pytest.mark.parametrize("name", ["", "a/b", "*", "a*", "$x", "a?b", "a#b", "a b", "é", "\n"])
def test_a_name_that_no_key_holds_is_refused(name: str) -> None:
    with pytest.raises(InvalidRequest, match="model: expected a name without spaces") as caught:
        zenoh_messages.anchors_key(name)
    assert caught.value.field == "model"
    with pytest.raises(InvalidRequest, match="replica: "):
        zenoh_messages.info_key(name)
