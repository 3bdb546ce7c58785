"""The binary codec: the bytes that it fixes, and the form that others send."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from golden_file import golden
from staged_planner import made_batch

from anchorflow_client import (
    STYLES,
    AnchorBatch,
    AnchorRequest,
    InvalidAnswer,
    ModelId,
    OipCodec,
    Payload,
)
from anchorflow_client.oip_message import pack

CODEC = OipCodec()
F32, F64 = np.float32, np.float64


def recorded(name: str, config: dict[str, Any], written: Payload) -> Payload:
    """The payload of a golden file, which holds the config that made it."""
    made = {
        "config": config,
        "header_length": written.header_length,
        "hex": written.body.hex(),
    }
    value = golden(Path(__file__).parent / "golden" / f"{name}.json", made)
    assert value["config"] == config
    return Payload(bytes.fromhex(value["hex"]), value["header_length"])


REQUEST_CONFIG = {
    "seed": 11,
    "map": [2, 2, 16, 17],
    "fields": {
        "x_curr": [-0.5, 0.25, 0.1, 0.0, 0.0, -0.2],
        "x_goal": [[0.5, 0.25, 0.0, 0.0], [0.5, -0.25, 0.0, 0.3]],
        "w_style": [0.5, 0.25, 0.25],
        "num_samples": 3,
        "model": "flowmp-small",
        "seed": 7,
        "sampler": {"method": "heun", "schedule": [0.0, 0.9, 1.0]},
        "refine": {"project": True, "safety_margin": 0.1},
        "warm_start": {"trajectory": [[-0.5, 0.25], [0.5, 0.25]], "tau": 0.75},
        "budget_ms": 80.0,
        "request_id": "golden-1",
    },
}
ANSWER_CONFIG = {"seed": 5, "scenes": 2, "anchors": 3, "steps": 4}
OWN_TIMES_CONFIG = ANSWER_CONFIG | {"dt": [[0.1, 0.2, 0.3], [0.7, 0.9, 1.1]]}
TIMED_WARM_START_CONFIG = REQUEST_CONFIG | {
    "fields": REQUEST_CONFIG["fields"]
    | {"warm_start": {"trajectory": [[-0.5, 0.25], [0.5, 0.25]], "tau": 0.75, "dt": 0.3}}
}


def golden_request(config: dict[str, Any]) -> AnchorRequest:
    grid = np.random.default_rng(config["seed"]).random(config["map"]).astype(F32) * F32(0.4)
    cost_map = {"data": grid, "resolution": 0.125, "origin": [-1.0, -1.0]}
    return AnchorRequest.build(cost_map=cost_map, **config["fields"])


def golden_answer(config: dict[str, Any]) -> AnchorBatch:
    generator = np.random.default_rng(config["seed"])
    anchors = (config["scenes"], config["anchors"])
    paths = generator.random((3, *anchors, config["steps"], 2)).astype(F32)
    per_anchor = generator.random((2, *anchors)).astype(F32)
    return made_batch(
        paths[0],
        velocities=paths[1],
        accelerations=paths[2],
        scores=per_anchor[0],
        clearance=per_anchor[1],
        safe=per_anchor[0] > 0.5,
        dt=np.array(config["dt"]) if "dt" in config else 0.125,
        seed=2**63 - 1,
        model=ModelId("flowmp-small", "0.1.0", "ab" * 32),
        timing_ms={"queue": 0.5, "total": 12.25},
        request_id="golden-1",
    )


@pytest.mark.parametrize(
    ("name", "config"),
    [("oip_request", REQUEST_CONFIG), ("oip_request_timed_warm_start", TIMED_WARM_START_CONFIG)],
)
def test_a_request_has_the_golden_bytes(name: str, config: dict[str, Any]) -> None:
    written = CODEC.encode_request(golden_request(config))
    expected = recorded(name, config, written)

    assert written == expected
    assert CODEC.encode_request(CODEC.decode_request(expected)) == expected


@pytest.mark.parametrize(
    ("name", "config"),
    [("oip_answer", ANSWER_CONFIG), ("oip_answer_own_times", OWN_TIMES_CONFIG)],
)
def test_an_answer_has_the_golden_bytes(name: str, config: dict[str, Any]) -> None:
    written = CODEC.encode_answer(golden_answer(config))
    expected = recorded(name, config, written)

    assert written == expected
    assert CODEC.encode_answer(CODEC.decode_answer(expected)) == expected


@pytest.mark.parametrize(
    ("dt", "parameter", "words"),
    [
        *(
            (dt, {}, "dt|not finite")
            for dt in (np.ones(3), np.zeros((2, 3)), np.full((2, 3), np.nan))
        ),
        (np.array(OWN_TIMES_CONFIG["dt"]), {"dt": 0.1}, "dt: expected this field once"),
    ],
    ids=["shape", "zero", "nan", "twice"],
)
def test_an_answer_with_another_dt_is_invalid(
    dt: np.ndarray, parameter: dict[str, float], words: str
) -> None:
    batch = golden_answer(OWN_TIMES_CONFIG)
    header = header_of(CODEC.encode_answer(golden_answer(ANSWER_CONFIG)))
    del header["parameters"]["dt"], header["outputs"]
    header["parameters"] |= parameter

    with pytest.raises(InvalidAnswer, match=words):
        CODEC.decode_answer(pack(header, "outputs", {**batch.arrays, "dt": dt}))


def header_of(payload: Payload) -> dict[str, Any]:
    return json.loads(payload.body[: payload.header_length])


@pytest.mark.parametrize("request_id", ["a" * n for n in range(1, 65, 7)])
def test_every_tensor_is_aligned(request_id: str) -> None:
    config = REQUEST_CONFIG | {"fields": REQUEST_CONFIG["fields"] | {"request_id": request_id}}
    payload = CODEC.encode_request(golden_request(config))

    offset = payload.header_length or 0
    assert offset % 64 == 0
    for entry in header_of(payload)["inputs"]:
        assert offset % {"FP32": 4, "FP64": 8}[entry["datatype"]] == 0
        offset += entry["parameters"]["binary_data_size"]


def test_the_tensors_of_8_bytes_are_aligned_in_an_answer() -> None:
    batch = made_batch(np.zeros((3, 1, 1)), dt=np.array([0.1, 0.2, 0.3]), routes=np.arange(3))
    payload = CODEC.encode_answer(batch)

    names = [entry["name"] for entry in header_of(payload)["outputs"]]
    assert names[:2] == ["dt", "routes"]
    read = CODEC.decode_answer(payload)
    assert read.routes is not None
    assert read.routes.flags.aligned
    assert list(read.arrays) == list(batch.arrays)


def test_what_is_read_is_the_body_itself_and_cannot_be_written() -> None:
    sent = CODEC.encode_request(golden_request(REQUEST_CONFIG))
    answered = CODEC.encode_answer(golden_answer(OWN_TIMES_CONFIG))

    grid = CODEC.decode_request(sent).cost_map.data
    batch = CODEC.decode_answer(answered)

    assert np.shares_memory(grid, np.frombuffer(sent.body, np.uint8))
    for name, array in {**batch.arrays, "dt": np.asarray(batch.dt)}.items():
        assert np.shares_memory(array, np.frombuffer(answered.body, np.uint8)), name
        assert not array.flags.writeable
    with pytest.raises(ValueError, match="read-only"):
        grid[...] = 0


def by_hand(**changes: Any) -> Payload:
    """A request as another Open Inference Protocol client sends it: FP32 alone, a B axis of 1."""
    tensors = {
        "cost_map": np.zeros((1, 1, 16, 20), F32),
        "map_geometry": np.array([[-5, -4, 0.5]], F32),
        "x_curr": np.array([[-3, 0.5, 0, 0, 0, 0]], F32),
        "x_goal": np.array([[3, 0.5, 0, 0]], F32),
    }
    header = {"parameters": {"num_samples": 4, "sampler.schedule": "8step"}} | changes
    return pack(header, "inputs", tensors)


def test_a_request_in_float32_is_read() -> None:
    request = CODEC.decode_request(by_hand())

    assert (request.num_scenes, request.batched, request.num_samples) == (1, True, 4)
    assert request.x_curr.tolist() == [[-3, 0.5, 0, 0, 0, 0]]
    assert (request.cost_map.resolution, request.cost_map.origin.tolist()) == (0.5, [-5, -4])
    assert request.sampler is not None
    assert request.sampler.schedule is not None
    assert len(request.sampler.schedule) == 9


def test_a_style_and_a_uniform_schedule_may_be_parameters() -> None:
    named = {"w_style": "efficient", "sampler.schedule.uniform": 2}
    request = CODEC.decode_request(by_hand(parameters=named))

    assert request.w_style.tolist() == [[*STYLES["efficient"]]]
    assert request.sampler is not None
    assert request.sampler.schedule == (0.0, 0.5, 1.0)


def test_a_body_that_can_be_written_is_read_only_all_the_same() -> None:
    payload = by_hand()
    body: Any = bytearray(payload.body)

    grid = CODEC.decode_request(Payload(body, payload.header_length)).cost_map.data

    assert not grid.flags.writeable


def test_a_later_services_answer_is_read() -> None:
    """What this version does not know is passed over: a tensor, a parameter, a key."""
    sent = CODEC.encode_answer(golden_answer(ANSWER_CONFIG))
    header: dict[str, Any] = {**header_of(sent), "new_key": [1]}
    header["parameters"]["new.parameter"] = "x"
    names = [entry["name"] for entry in header.pop("outputs")]
    batch = CODEC.decode_answer(sent)
    tensors = {name: getattr(batch, name) for name in names}
    later = pack(header, "outputs", {"new_tensor": np.zeros((2, 2), F32), **tensors})

    np.testing.assert_array_equal(CODEC.decode_answer(later).safe, batch.safe)
