"""The JSON codec reads back what it wrote, and refuses bytes that it cannot parse."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from anchorflow_client import (
    AnchorBatch,
    AnchorRequest,
    InvalidAnswer,
    InvalidRequest,
    JsonCodec,
    ModelId,
    Payload,
)

CODEC = JsonCodec()


@settings(max_examples=100)
@given(st.binary(max_size=40))
def test_no_bytes_break_the_reader(body: bytes) -> None:
    with pytest.raises(InvalidRequest):
        CODEC.decode_request(Payload(body))
    with pytest.raises(InvalidAnswer):
        CODEC.decode_answer(Payload(body))


def test_a_map_shared_by_a_batch_travels_once(fields: dict[str, Any]) -> None:
    fields["x_curr"] = [fields["x_curr"]] * 5
    request = AnchorRequest.from_fields(fields)

    sent = json.loads(CODEC.encode_request(request).body)

    assert np.shape(sent["cost_map"]["data"]) == (1, 16, 20)
    assert np.shape(sent["x_curr"]) == (5, 6)


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (b'{"x_curr": [1, 2', "breaks at position 16 of 16"),
        (b"", "breaks at position 0 of 0"),
        (b"\xff\xfe{", "breaks at position 0 of 3: not UTF-8"),
        ("{}".encode("utf-16"), "not UTF-8"),
        (b"[" * 100_000, "expected the contract's JSON, got lists nested too deep"),
        (b"9" * 10_000, "expected the contract's JSON, got an integer of too many digits"),
        (b"[1, 2]", "expected an object, got a list of 2"),
    ],
)
def test_a_body_that_is_no_object_is_refused(body: bytes, words: str) -> None:
    with pytest.raises(InvalidRequest) as caught:
        CODEC.decode_request(Payload(body))

    assert caught.value.field == "body"
    assert words in caught.value.message


@pytest.mark.parametrize("literal", ["NaN", "Infinity", "-Infinity", "1e999"])
def test_a_literal_that_is_not_finite_is_refused_by_its_field(
    fields: dict[str, Any], literal: str
) -> None:
    body = json.dumps(fields | {"x_goal": [3.0, 0.5, 12345, 0]}).replace("12345", literal)

    with pytest.raises(InvalidRequest, match=r"finite numbers, got -?(nan|inf) at x_goal\[2\]"):
        CODEC.decode_request(Payload(body.encode()))


def test_an_answer_with_numbers_that_are_not_finite_is_not_sent() -> None:
    paths = np.full((1, 2, 2), np.nan, np.float32)
    batch = AnchorBatch(
        arrays={
            "trajectories": paths,
            "velocities": paths,
            "accelerations": paths,
            "scores": paths[:, 0, 0],
            "clearance": paths[:, 0, 0],
            "safe": np.zeros(1, bool),
        },
        dt=0.1,
        seed=1,
        model=ModelId("a", "b", "c"),
        timing_ms={},
    )

    with pytest.raises(ValueError, match="not finite"):
        CODEC.encode_answer(batch)


def answer_in_json(**changes: Any) -> Payload:
    """Two anchors of two steps, as a service writes them."""
    paths = np.zeros((2, 2, 2), np.float32)
    batch = AnchorBatch(
        arrays={"trajectories": paths},
        dt=np.array([0.1, 0.7]),
        seed=1,
        model=ModelId("a", "b", "c"),
        timing_ms={},
    )
    return Payload(json.dumps(json.loads(CODEC.encode_answer(batch).body) | changes).encode())


def test_dt_is_a_number_or_a_list() -> None:
    assert json.loads(answer_in_json().body)["dt"] == [0.1, 0.7]
    np.testing.assert_array_equal(CODEC.decode_answer(answer_in_json()).durations, [0.1, 0.7])
    assert CODEC.decode_answer(answer_in_json(dt=1)).dt == 1.0


@pytest.mark.parametrize(
    "dt", [None, "0.1", [0.1], [0.1, None], [[0.1, 0.2]], [0.1, "0.2"], 0, [0.1, -1], [0.1, [0.2]]]
)
def test_an_answer_with_another_dt_is_invalid(dt: Any) -> None:
    with pytest.raises(InvalidAnswer, match=r"dt|inhomogeneous"):
        CODEC.decode_answer(answer_in_json(dt=dt))


@pytest.mark.parametrize("body", [b"<html>", b"[]", b"{}", b'{"model": 3}', b'{"timing_ms": []}'])
def test_an_answer_of_another_program_is_invalid(body: bytes) -> None:
    with pytest.raises(InvalidAnswer):
        CODEC.decode_answer(Payload(body))
