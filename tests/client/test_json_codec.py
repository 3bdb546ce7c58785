"""The JSON codec: what goes in comes out, and what cannot be read is refused."""

from __future__ import annotations

import json
from dataclasses import fields as dataclass_fields
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from anchorflow_client import (
    AnchorBatch,
    AnchorRequest,
    InvalidAnswer,
    InvalidRequest,
    JsonCodec,
    ModelId,
    Payload,
)

FINITE32 = st.floats(width=32, allow_nan=False, allow_infinity=False)
CODEC = JsonCodec()


def assert_same(left: Any, right: Any) -> None:
    """Equal field by field, to the last bit."""
    for field in dataclass_fields(left):
        a, b = getattr(left, field.name), getattr(right, field.name)
        if isinstance(a, np.ndarray):
            np.testing.assert_array_equal(a, b)
            assert a.dtype == b.dtype
        elif field.name in ("cost_map", "warm_start") and a is not None:
            assert_same(a, b)
        else:
            assert a == b, field.name


@st.composite
def requests(draw: st.DrawFn) -> AnchorRequest:
    """Any request over a map of a few cells, batched or not."""
    batch = draw(st.sampled_from([(), (1,), (3,)]))
    shared = draw(st.booleans())
    cells, dim = draw(st.integers(1, 3)), draw(st.sampled_from([2, 3]))
    free = hnp.arrays(
        np.float32,
        (*(() if shared else batch), cells, 16, 17),
        elements=st.floats(0, 0.4375, width=32),
        fill=st.just(0.0),
    )
    options = {
        "w_style": hnp.arrays(float, (*batch, 3), elements=st.floats(0.01, 9)),
        "num_samples": st.integers(1, 512),
        "robot_radius": st.floats(0, 5),
        "seed": st.integers(0, 2**63 - 1),
        "model": st.just("flowmp-small"),
        "sampler": st.sampled_from(
            [{"method": "heun"}, {"schedule": "8step"}, {"schedule": {"uniform": 7}}]
        ),
        "refine": st.fixed_dictionaries(
            {}, optional={"smooth": st.booleans(), "safety_margin": st.floats(0, 5)}
        ),
        "warm_start": st.just({"trajectory": [[0.1] * dim, [0.3] * dim], "tau": 0.7}),
        "budget_ms": st.floats(1, 1e6),
        "request_id": st.text("abc-123", min_size=1, max_size=9),
    }
    positions = st.floats(-0.7, 0.7)
    return AnchorRequest.build(
        cost_map={"data": draw(free), "resolution": 0.1, "origin": [-0.8, -0.8]},
        x_curr=draw(hnp.arrays(float, (*batch, 3 * dim), elements=positions)),
        x_goal=draw(hnp.arrays(float, (*batch, 2 * dim), elements=positions)),
        **draw(st.fixed_dictionaries({}, optional=options)),
    )


@st.composite
def batches(draw: st.DrawFn) -> AnchorBatch:
    """Any answer of a few anchors."""
    anchors = draw(st.sampled_from([(2,), (3, 2)]))
    paths = hnp.arrays(np.float32, (*anchors, 3, draw(st.integers(2, 3))), elements=FINITE32)
    trajectories = draw(paths)
    per_anchor = hnp.arrays(np.float32, anchors, elements=FINITE32)
    return AnchorBatch(
        trajectories=trajectories,
        velocities=trajectories[..., ::-1],
        accelerations=trajectories * np.float32(0.5),
        scores=draw(per_anchor),
        clearance=draw(per_anchor),
        safe=draw(hnp.arrays(bool, anchors)),
        dt=draw(st.floats(0.01, 1)),
        seed=draw(st.integers(0, 2**63 - 1)),
        model=ModelId("flowmp-small", "0.1.0", "ab" * 32),
        timing_ms=draw(st.dictionaries(st.sampled_from(["queue", "total"]), st.floats(0, 1e6))),
        request_id=draw(st.none() | st.text(max_size=5)),
    )


@settings(max_examples=40)
@given(requests())
def test_a_request_comes_back_as_it_went(request: AnchorRequest) -> None:
    assert_same(CODEC.decode_request(CODEC.encode_request(request)), request)


@settings(max_examples=40)
@given(batches())
def test_an_answer_comes_back_as_it_went(batch: AnchorBatch) -> None:
    assert_same(CODEC.decode_answer(CODEC.encode_answer(batch)), batch)


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
        (b"\xff\xfe{", "body"),
        (b"[" * 100_000, "body"),
        (b"9" * 10_000, "body"),
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
        trajectories=paths,
        velocities=paths,
        accelerations=paths,
        scores=paths[:, 0, 0],
        clearance=paths[:, 0, 0],
        safe=np.zeros(1, bool),
        dt=0.1,
        seed=1,
        model=ModelId("a", "b", "c"),
        timing_ms={},
    )

    with pytest.raises(ValueError, match="not finite"):
        CODEC.encode_answer(batch)


@pytest.mark.parametrize("body", [b"<html>", b"[]", b"{}", b'{"model": 3}', b'{"timing_ms": []}'])
def test_an_answer_of_another_program_is_invalid(body: bytes) -> None:
    with pytest.raises(InvalidAnswer):
        CODEC.decode_answer(Payload(body))
