"""The service's codec speaks exactly the client's language."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from anchorflow_client import (
    AnchorBatch,
    AnchorRequest,
    InvalidRequest,
    JsonCodec,
    ModelId,
    Payload,
)
from anchorflow_service.http.orjson_codec import OrjsonCodec


def batch(paths: np.ndarray, dt: Any = 8 / 63) -> AnchorBatch:
    per_anchor = paths[..., 0, 0]
    return AnchorBatch(
        arrays={
            "trajectories": paths,
            "velocities": paths[..., ::-1],  # not contiguous
            "accelerations": paths,
            "scores": per_anchor,
            "clearance": per_anchor,
            "safe": per_anchor > 0,
        },
        dt=dt,
        seed=2**63 - 1,
        model=ModelId("lines", "1", "ab"),
        timing_ms={"total": np.float64(0.1)},
        request_id="é",
    )


@pytest.mark.parametrize("shape", [(5, 7, 2), (2, 5, 7, 3)])
def test_both_codecs_write_the_same_answer(shape: tuple[int, ...]) -> None:
    answer = batch(np.random.default_rng(0).normal(size=shape).astype(np.float32))

    sent = OrjsonCodec().encode_answer(answer)

    came = JsonCodec().decode_answer(sent)
    np.testing.assert_array_equal(came.trajectories, answer.trajectories)
    np.testing.assert_array_equal(came.velocities, answer.velocities)
    assert (came.seed, came.dt, came.request_id) == (answer.seed, answer.dt, "é")
    assert json.loads(sent.body).keys() == json.loads(JsonCodec().encode_answer(answer).body).keys()


@pytest.mark.parametrize("shape", [(5, 7, 2), (2, 5, 7, 3)])
def test_own_time_steps_come_back_to_the_last_bit(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(0)
    answer = batch(rng.normal(size=shape), dt=rng.random(shape[:-2]) + 0.01)

    came = JsonCodec().decode_answer(OrjsonCodec().encode_answer(answer))

    np.testing.assert_array_equal(came.dt, answer.dt)


def test_both_codecs_write_the_same_request(fields: dict[str, Any]) -> None:
    request = AnchorRequest.from_fields(fields)

    by_orjson, by_json = (
        codec.encode_request(request).body for codec in (OrjsonCodec(), JsonCodec())
    )

    assert json.loads(by_orjson) == json.loads(by_json)


@pytest.mark.parametrize("body", [b"NaN", b"[1, 2", b'{"x_curr": [NaN', b"9" * 10_000, b"\xff"])
def test_both_codecs_refuse_the_same_bodies(body: bytes) -> None:
    for codec in (OrjsonCodec(), JsonCodec()):
        with pytest.raises(InvalidRequest) as caught:
            codec.decode_request(Payload(body))
        assert caught.value.field == "body"


@pytest.mark.parametrize("literal", ["NaN", "-Infinity", "Infinity", "1e999", "-1e999"])
def test_a_literal_that_is_not_finite_is_refused_by_its_field(
    fields: dict[str, Any], literal: str
) -> None:
    text = json.dumps(fields | {"model": "é", "x_goal": [3.0, 0.5, 12345, 0]}, ensure_ascii=False)

    with pytest.raises(InvalidRequest, match=r"finite numbers, got -?(nan|inf) at x_goal\[2\]"):
        OrjsonCodec().decode_request(Payload(text.replace("12345", literal).encode()))
