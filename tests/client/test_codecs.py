"""Every codec reads back what it wrote, to the last bit; JSON that cannot be read is refused."""

from __future__ import annotations

import json
from dataclasses import fields as dataclass_fields
from typing import Any

import numpy as np
import pytest
from bad_fields import NOT_JSON
from hypothesis import given, settings, strategies as st
from hypothesis.extra import numpy as hnp
from staged_planner import made_batch

from anchorflow_client import (
    STYLES,
    AnchorBatch,
    AnchorRequest,
    Codec,
    EncodedImage,
    InvalidAnswer,
    InvalidRequest,
    JsonCodec,
    ModelId,
    OipCodec,
    Payload,
)
from anchorflow_service.http.orjson_codec import OrjsonCodec

FINITE32 = st.floats(width=32, allow_nan=False, allow_infinity=False)
JSON = JsonCodec()
BASE64 = JsonCodec(base64=True)
ORJSON = OrjsonCodec()
CODECS = [JSON, BASE64, OipCodec(), ORJSON]
PAIRS = [
    *((codec, codec) for codec in CODECS),
    *((JSON, ORJSON), (ORJSON, JSON), (BASE64, ORJSON), (OrjsonCodec(base64=True), BASE64)),
]
"""Who writes and who reads: the client and the service have a JSON codec each."""


def assert_same(left: Any, right: Any) -> None:
    """Equal field by field, to the last bit."""
    for field in dataclass_fields(left):
        a, b = getattr(left, field.name), getattr(right, field.name)
        if isinstance(a, np.ndarray):
            assert isinstance(b, np.ndarray)
            np.testing.assert_array_equal(a, b)
            assert a.dtype == b.dtype
        elif field.name in ("map_scenes", "cost_map", "warm_start", "obstacles") and a is not None:
            assert_same(a, b)
        elif field.name == "arrays":
            assert list(left.arrays) == list(right.arrays)
            for name, array in left.arrays.items():
                np.testing.assert_array_equal(array, right.arrays[name])
                assert array.dtype == right.arrays[name].dtype
        else:
            assert a == b, field.name


@st.composite
def obstacles(draw: st.DrawFn) -> dict[str, Any]:
    """A few tracks, with velocities or a forecast or both, or none at all."""
    size, steps = draw(st.integers(0, 3)), draw(st.integers(1, 3))

    def arrays(*shape: int, low: float = -90.0) -> st.SearchStrategy[Any]:
        return hnp.arrays(float, (size, *shape), elements=st.floats(low, 90.0))

    forecast = {"forecast": arrays(steps, 2), "forecast_dt": st.floats(1e-3, 600)}
    motion = draw(
        st.sampled_from([{"velocity": arrays(2)}, forecast, forecast | {"velocity": arrays(2)}])
    )
    fields = {"position": arrays(2), "radius": arrays(low=0.0), **motion}
    return draw(st.fixed_dictionaries(fields, optional={"growth": st.floats(0, 9)}))


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
        "w_style": hnp.arrays(float, (*batch, 3), elements=st.floats(0.01, 9))
        | st.sampled_from([*STYLES]),
        "num_samples": st.integers(1, 512),
        "robot_radius": st.floats(0, 5),
        "seed": st.integers(0, 2**63 - 1),
        "model": st.just("flowmp-small"),
        "sampler": st.sampled_from(
            [{"method": "heun"}, {"schedule": "8step"}, {"schedule": {"uniform": 7}}]
        ),
        "refine": st.fixed_dictionaries(
            {}, optional={"smooth": st.booleans(), "safety_margin": st.floats(0, 5)}
        ).filter(bool),
        "horizon_s": st.floats(0.1, 600),
        "cost_penalty": st.floats(0, 100),
        "clear_start": st.booleans(),
        "goal_tolerance": st.fixed_dictionaries(
            {"position": st.floats(0, 100)}, optional={"heading": st.floats(0, 3)}
        ),
        "obstacles": obstacles(),
        "footprint": st.sampled_from(
            [[[-0.4, -0.3], [0.5, -0.3], [0.5, 0.4], [-0.4, 0.3]], (np.eye(3, 2) - 0.3).tolist()]
        ),
        "kinematics": st.fixed_dictionaries(
            {"kind": st.just("ackermann"), "min_turning_radius": st.floats(0.1, 9)},
            optional={"omega_max": st.floats(0.1, 9), "reverse": st.booleans()},
        ),
        "warm_start": st.fixed_dictionaries(
            {"trajectory": st.just([[0.1] * dim, [0.3] * dim]), "tau": st.just(0.7)},
            optional={"dt": st.floats(1e-3, 600)},
        ),
        "budget_ms": st.floats(1, 1e6),
        "request_id": st.text("abc-123", min_size=1, max_size=9),
    }
    positions = st.floats(-0.7, 0.7)
    weights = st.none() | hnp.arrays(float, cells - 1, elements=st.floats(0, 100))
    return AnchorRequest.build(
        cost_map={
            "data": draw(free),
            "resolution": 0.13,
            "origin": [-1.1, -1.0],
            "channel_weights": draw(weights),
        },
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
    return made_batch(
        trajectories,
        velocities=trajectories[..., ::-1],
        accelerations=trajectories * np.float32(0.5),
        scores=draw(per_anchor),
        clearance=draw(per_anchor),
        safe=draw(hnp.arrays(bool, anchors)),
        **draw(st.fixed_dictionaries({}, optional={"routes": hnp.arrays(np.int64, anchors)})),
        dt=draw(st.floats(0.01, 1) | hnp.arrays(float, anchors, elements=st.floats(1e-6, 600))),
        seed=draw(st.integers(0, 2**63 - 1)),
        model=ModelId("flowmp-small", "0.1.0", "ab" * 32),
        timing_ms=draw(st.dictionaries(st.sampled_from(["queue", "total"]), st.floats(0, 1e6))),
        request_id=draw(st.none() | st.text(max_size=5)),
    )


@pytest.mark.parametrize(("writer", "reader"), PAIRS)
@settings(max_examples=30)
@given(requests())
def test_a_request_comes_back_as_it_went(
    writer: Codec, reader: Codec, asked: AnchorRequest
) -> None:
    assert_same(reader.decode_request(writer.encode_request(asked)), asked)


@pytest.mark.parametrize(("writer", "reader"), PAIRS)
@settings(max_examples=30)
@given(batches())
def test_an_answer_comes_back_as_it_went(writer: Codec, reader: Codec, batch: AnchorBatch) -> None:
    assert_same(reader.decode_answer(writer.encode_answer(batch)), batch)


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize(
    ("given", "sent"),
    [("i1", "i8"), ("u2", "i8"), (">i4", "i8"), ("u8", "i8"), ("f2", "f4"), ("g", "f8")],
)
def test_an_input_of_a_type_that_the_wire_lacks_is_widened(
    codec: Codec, given: str, sent: str
) -> None:
    asked = AnchorRequest.build(inputs={"ego_status": np.array([1, 0, 5], given)})

    came = codec.decode_request(codec.encode_request(asked)).inputs["ego_status"]

    assert isinstance(came, np.ndarray)
    assert (came.dtype, came.tolist()) == (np.dtype(sent), [1, 0, 5])


def test_an_input_that_no_type_of_the_wire_holds_is_refused() -> None:
    with pytest.raises(InvalidRequest, match=r"inputs\.ego_status: expected numbers that int64 h"):
        AnchorRequest.build(inputs={"ego_status": np.full(8, 2**64 - 1, np.uint64)})


def test_a_picture_is_bytes() -> None:
    with pytest.raises(InvalidRequest, match="data: expected bytes, got the string 'abc'"):
        EncodedImage("png", "abc")  # pyright: ignore[reportArgumentType] - the mistake


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize("name", ["trajectories", "scores"])
def test_an_answer_with_numbers_that_are_not_finite_is_not_sent(codec: Codec, name: str) -> None:
    batch = made_batch(**{name: np.full_like(getattr(made_batch(), name), np.nan)})

    with pytest.raises(ValueError, match="not finite"):
        codec.encode_answer(batch)


@settings(max_examples=100)
@given(st.binary(max_size=40))
def test_no_bytes_break_the_reader(body: bytes) -> None:
    for codec in (JSON, ORJSON):
        with pytest.raises(InvalidRequest):
            codec.decode_request(Payload(body))
        with pytest.raises(InvalidAnswer):
            codec.decode_answer(Payload(body))


def test_a_map_shared_by_a_batch_travels_once(fields: dict[str, Any]) -> None:
    fields["x_curr"] = [fields["x_curr"]] * 5
    request = AnchorRequest.from_fields(fields)

    sent = json.loads(JSON.encode_request(request).body)

    assert np.shape(sent["cost_map"]["data"]) == (1, 16, 20)
    assert np.shape(sent["x_curr"]) == (5, 6)


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (b"", "position 0 of 0"),
        (b"\xff", "position 0 of 1: not UTF-8"),
        (b"[" * 60_000, "lists nested too deep"),
        (b'{"x_curr": [NaN', "position 15 of 15"),
        *NOT_JSON.items(),
    ],
)
def test_a_body_that_is_no_object_is_refused(body: bytes, words: str) -> None:
    with pytest.raises(InvalidRequest) as caught:
        JSON.decode_request(Payload(body))

    assert caught.value.field == "body"
    assert words in caught.value.message


@pytest.mark.parametrize("codec", [JSON, ORJSON])
@pytest.mark.parametrize("literal", ["NaN", "Infinity", "-Infinity", "1e999", "-1e999"])
def test_a_literal_that_is_not_finite_is_refused_by_its_field(
    fields: dict[str, Any], codec: JsonCodec, literal: str
) -> None:
    text = json.dumps(fields | {"model": "é", "x_goal": [3.0, 0.5, 12345, 0]}, ensure_ascii=False)

    with pytest.raises(InvalidRequest, match=r"finite numbers, got -?(nan|inf) at x_goal\[2\]"):
        codec.decode_request(Payload(text.replace("12345", literal).encode()))


def answer_in_json(**changes: Any) -> Payload:
    """Two anchors of two steps, as a service writes them."""
    batch = made_batch(np.zeros((2, 2, 2)), dt=np.array([0.1, 0.7]))
    return Payload(json.dumps(json.loads(JSON.encode_answer(batch).body) | changes).encode())


def test_dt_is_a_number_or_a_list() -> None:
    assert json.loads(answer_in_json().body)["dt"] == [0.1, 0.7]
    np.testing.assert_array_equal(JSON.decode_answer(answer_in_json()).durations, [0.1, 0.7])
    assert JSON.decode_answer(answer_in_json(dt=1)).dt == 1.0


@pytest.mark.parametrize(
    "dt", [None, "0.1", [0.1], [0.1, None], [[0.1, 0.2]], [0.1, "0.2"], 0, [0.1, -1], [0.1, [0.2]]]
)
def test_an_answer_with_another_dt_is_invalid(dt: Any) -> None:
    with pytest.raises(InvalidAnswer, match=r"dt|inhomogeneous"):
        JSON.decode_answer(answer_in_json(dt=dt))


@pytest.mark.parametrize("reason", [None, "none of 2 anchors is safe: the start …"])
def test_the_reason_is_a_sentence_or_null(reason: str | None) -> None:
    batch = made_batch(np.zeros((2, 2, 2)), reason=reason)
    assert json.loads(JSON.encode_answer(batch).body)["reason"] == reason
    for codec in (JSON, OipCodec()):
        assert codec.decode_answer(codec.encode_answer(batch)).reason == reason
    with pytest.raises(InvalidAnswer, match="expected a string or null in reason, got 3"):
        JSON.decode_answer(answer_in_json(reason=3))


def test_routes_are_whole_numbers() -> None:
    assert JSON.decode_answer(answer_in_json(routes=[3, 0])).arrays["routes"].dtype == np.int64
    with pytest.raises(InvalidAnswer, match="expected whole numbers in routes"):
        JSON.decode_answer(answer_in_json(routes=[0.5, 1]))


@pytest.mark.parametrize(
    ("bad", "words"),
    [({"base64": "AAAA"}, "trajectories.base64"), ({"shape": [1, 2]}, "expected 8 bytes")],
)
def test_bytes_that_are_no_array_are_an_invalid_answer(bad: dict[str, Any], words: str) -> None:
    whole = {"dtype": "float32", "shape": [1, 2, 2], "base64": "A" * 20 + "==="}
    with pytest.raises(InvalidAnswer, match=words):
        JSON.decode_answer(answer_in_json(trajectories=whole | bad))


@pytest.mark.parametrize("body", [b"<html>", b"[]", b"{}", b'{"model": 3}', b'{"timing_ms": []}'])
def test_an_answer_of_another_program_is_invalid(body: bytes) -> None:
    with pytest.raises(InvalidAnswer):
        JSON.decode_answer(Payload(body))
