"""Hostile and damaged binary bodies: always the documented error with its field, never a crash."""

from __future__ import annotations

import json
import tracemalloc
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from bad_fields import NOT_JSON
from staged_planner import made_batch

from anchorflow_client import InvalidAnswer, InvalidRequest, OipCodec, Payload
from anchorflow_client.oip_message import MAX_HEADER_BYTES, pack

CODEC = OipCodec()
F32 = np.float32
TENSORS: dict[str, np.ndarray] = {
    "x_curr": np.array([-3, 0.5, 0, 0, 0, 0]),
    "x_goal": np.array([3, 0.5, 0, 0]),
    "cost_map": np.zeros((1, 16, 20), F32),
    "map_geometry": np.array([-5, -4, 0.5], F32),
}
REQUEST = pack({"id": "r1", "parameters": {"seed": 1, "num_samples": 4}}, "inputs", TENSORS)

Header = dict[str, Any]
Edit = Callable[[Header], object]
ANSWER = CODEC.encode_answer(
    made_batch(np.arange(12, dtype=F32).reshape(2, 3, 2), safe=[True, False])
)


def split(payload: Payload) -> tuple[Header, bytes]:
    length = payload.header_length or 0
    return json.loads(payload.body[:length]), payload.body[length:]


def joined(header: Any, data: bytes) -> Payload:
    raw = header if isinstance(header, bytes) else json.dumps(header).encode()
    return Payload(raw + data, len(raw))


def edited(payload: Payload, edit: Edit, data: bytes | None = None) -> Payload:
    header, tensors = split(payload)
    edit(header)
    return joined(header, tensors if data is None else data)


def refusal(payload: Payload) -> InvalidRequest:
    with pytest.raises(InvalidRequest) as caught:
        CODEC.decode_request(payload)
    assert caught.value.field
    assert caught.value.field in caught.value.message
    json.dumps(caught.value.to_dict()).encode()
    return caught.value


def assert_invalid_answer(payload: Payload, words: str) -> None:
    with pytest.raises(InvalidAnswer, match=words):
        CODEC.decode_answer(payload)


def entry(index: int, **changes: Any) -> Edit:
    return lambda header: header["inputs"][index].update(changes)


def size(index: int, value: Any) -> Edit:
    return entry(index, parameters={"binary_data_size": value})


def parameter(name: str, value: Any) -> Edit:
    return lambda header: header["parameters"].update({name: value})


def field(name: str, value: Any) -> Edit:
    return lambda header: header.update({name: value})


SURPLUS = {
    "name": "w_style",
    "datatype": "FP32",
    "shape": [3],
    "parameters": {"binary_data_size": 12},
}


HUGE = 10**30
BAD_HEADERS: dict[str, tuple[Edit, str, str]] = {
    "size too small": (size(2, 1276), "cost_map", "expected 1280 bytes for FP32 [1, 16, 20]"),
    "size too large": (size(2, 1284), "cost_map", "got a binary_data_size of 1284"),
    "size of an ocean": (size(2, HUGE), "cost_map", "got a binary_data_size of 1000000000"),
    "negative size": (size(0, -48), "x_curr.parameters.binary_data_size", "got -48"),
    "boolean size": (size(0, True), "x_curr.parameters.binary_data_size", "the boolean true"),
    "size with a fraction": (size(0, 48.0), "x_curr.parameters.binary_data_size", "got 48.0"),
    "no size": (entry(0, parameters={}), "x_curr.parameters.binary_data_size", "required"),
    "no parameters": (entry(0, parameters=None), "inputs[0].parameters", "required"),
    "data in the header": (entry(0, data=[0] * 6), "inputs[0].data", "unknown field"),
    "huge shape": (entry(2, shape=[HUGE, HUGE, HUGE, HUGE]), "cost_map", "bytes for FP32"),
    "huge empty shape": (entry(2, shape=[0, HUGE]), "cost_map", "whole numbers from 1 on, got 0"),
    "negative shape": (entry(2, shape=[-1, -16, 20]), "cost_map", "from 1 on, got -1"),
    "shape of text": (entry(2, shape="[1,16,20]"), "cost_map", "a shape of at most 8 axes"),
    "shape of booleans": (entry(2, shape=[True, 16, 20]), "cost_map", "the boolean true"),
    "many axes": (entry(2, shape=[1] * 40), "cost_map", "at most 8 axes, got a list of 40"),
    "other shape": (entry(2, shape=[20, 16, 1]), "cost_map.data", "C from 1 to 16, got 20"),
    "flat shape": (entry(2, shape=[320]), "cost_map.data", "expected shape [C,H,W]"),
    "geometry of columns": (entry(3, shape=[3, 1]), "map_geometry", "[3] or [B,3], got [3, 1]"),
    "integers": (entry(2, datatype="INT32"), "cost_map", "FP32, FP64, got the string 'INT32'"),
    "booleans": (entry(2, datatype="BOOL"), "cost_map", "got the string 'BOOL'"),
    "text": (entry(2, datatype="BYTES"), "cost_map", "got the string 'BYTES'"),
    "doubles": (entry(2, datatype="FP64"), "cost_map", "expected 2560 bytes for FP64"),
    "misspelt tensor": (entry(2, name="costs"), "cost_map.data", "required"),
    "text that is none": (entry(0, datatype="BYTES"), "x_curr", "one of FP32, FP64"),
    "unprintable name": (entry(2, name="\ud800"), "inputs[2].name", "printable ASCII"),
    "the same twice": (entry(1, name="x_curr"), "x_curr", "expected one tensor of this name"),
    "tensor is no object": (lambda header: header["inputs"].append(3), "inputs[4]", "got 3"),
    "inputs are no list": (field("inputs", {}), "inputs", "got an object"),
    "no inputs": (lambda header: header.pop("inputs"), "inputs", "required"),
    "surplus tensor": (
        lambda header: header["inputs"].append(SURPLUS),
        "w_style",
        "12 bytes, got 0",
    ),
    "outputs are no list": (field("outputs", {"a": 1}), "outputs", "a list of"),
    "output with nonsense": (
        field("outputs", [{"name": "safe", "parameters": "nonsense"}]),
        "outputs[0].parameters",
        "an object, got the string",
    ),
    "output in JSON": (
        field("outputs", [{"name": "safe", "parameters": {"binary_data": False}}]),
        "safe.parameters.binary_data",
        "got false",
    ),
    "output without a name": (field("outputs", [{}]), "outputs[0].name", "required"),
    "resolution twice": (
        parameter("cost_map.resolution", 0.5),
        "cost_map.resolution",
        "parameter too",
    ),
    "nameless field": (field("", 1), '""', "unknown field"),
    "outputs in JSON": (parameter("binary_data_output", False), "binary_data_output", "got false"),
    "id of another type": (field("id", 3), "request_id", "a string, got 3"),
    "id twice": (parameter("request_id", "r2"), "request_id", "as a parameter too"),
    "tensor as parameter": (parameter("x_curr", "0"), "x_curr", "as a parameter too"),
    "parameters are a list": (field("parameters", []), "parameters", "object"),
    "parameter is a list": (parameter("seed", [1]), "seed", "a string, a number or a boolean"),
    "parameter is null": (parameter("seed", None), "seed", "a string, a number or a boolean"),
    "unknown parameter": (parameter("sead", 1), "sead", "did you mean 'seed'?"),
    "unprintable parameter": (parameter("\ud800", 1), "parameters", "printable ASCII"),
    "parameter through another": (parameter("seed.low", 1), "seed.low", "got both"),
    "not finite parameter": (parameter("budget_ms", float("nan")), "budget_ms", "got nan"),
    "too many samples": (parameter("num_samples", 513), "num_samples", "got 513"),
}


@pytest.mark.parametrize(("edit", "name", "words"), BAD_HEADERS.values(), ids=BAD_HEADERS)
def test_a_header_that_lies_is_refused_by_field(edit: Edit, name: str, words: str) -> None:
    error = refusal(edited(REQUEST, edit))

    assert error.field == name
    assert words in error.message


@pytest.mark.parametrize("index", range(4))
def test_a_missing_tensor_is_refused(index: int) -> None:
    name = list(TENSORS)[index]
    rest = {other: tensor for other, tensor in TENSORS.items() if other != name}
    missing = pack({}, "inputs", rest)

    assert refusal(missing).field == (
        "cost_map.resolution" if name == "map_geometry" else name.replace("_map", "_map.data")
    )
    # The header leaves it out and the bytes are still there.
    assert refusal(edited(REQUEST, lambda header: header["inputs"].pop(index))).field


def test_bytes_that_no_tensor_declares_are_refused() -> None:
    error = refusal(Payload(REQUEST.body + b"\0", REQUEST.header_length))

    assert error.field == "body"
    assert "expected 1372, as its tensors declare, got 1373" in error.message


def test_a_body_cut_anywhere_is_refused() -> None:
    for end in range(0, len(REQUEST.body), 7):
        refusal(Payload(REQUEST.body[:end], REQUEST.header_length))


@pytest.mark.parametrize("length", [None, -1, 0, len(REQUEST.body) + 1, HUGE, -HUGE])
def test_a_header_length_that_cannot_be_is_refused(length: int | None) -> None:
    error = refusal(Payload(REQUEST.body, length))

    assert error.field == "header_length"
    assert_invalid_answer(Payload(ANSWER.body, length), "header_length")


@pytest.mark.parametrize("length", range(1, REQUEST.header_length or 0, 11))
def test_a_header_length_that_lies_is_refused(length: int) -> None:
    refusal(Payload(REQUEST.body, length))


def test_a_header_longer_than_any_contract_is_not_parsed() -> None:
    payload = joined(b" " * (MAX_HEADER_BYTES + 1), b"")

    assert refusal(payload).field == "header_length"


@pytest.mark.parametrize(
    ("header", "words"),
    [(b"NaN", "got nan"), (b"[" * 60_000, "lists nested too deep"), *NOT_JSON.items()],
)
def test_a_header_that_is_no_json_object_is_refused(header: bytes, words: str) -> None:
    error = refusal(joined(header, b""))

    assert error.field == "header"
    assert words in error.message
    assert_invalid_answer(joined(header, b""), "header")


def test_numbers_that_are_not_finite_are_refused_by_tensor() -> None:
    for name in ("x_curr", "x_goal", "map_geometry"):
        broken = TENSORS[name].copy()
        broken[2] = np.nan
        error = refusal(pack({}, "inputs", TENSORS | {name: broken}))
        assert error.field == name
        assert "finite numbers" in error.message


def test_scenes_that_lie_apart_are_refused() -> None:
    places = np.array([[-5, -4, 0.5], [-5, -3, 0.5]], F32)

    assert refusal(pack({}, "inputs", TENSORS | {"map_geometry": places})).field == "map_geometry"


def first_output(**changes: Any) -> Edit:
    return lambda header: header["outputs"][0].update(changes)


BAD_ANSWERS: dict[str, tuple[Edit, str]] = {
    "no model": (lambda header: header.pop("model_name"), "model"),
    "model is a list": (field("model_name", []), "model"),
    "no dt": (lambda header: header["parameters"].pop("dt"), "dt"),
    "dt is infinite": (parameter("dt", float("inf")), "not finite"),
    "seed is infinite": (parameter("seed", float("inf")), "answer"),
    "no outputs": (lambda header: header.pop("outputs"), "outputs"),
    "outputs are empty": (field("outputs", []), "body"),
    "doubles": (first_output(datatype="FP64"), "trajectories"),
    "other shape": (first_output(shape=[3, 2, 2]), "velocities"),
    "flat": (first_output(shape=[12]), "trajectories"),
    "timing is text": (parameter("timing_ms.total", "soon"), "soon"),
    "timing is no object": (parameter("timing_ms", 1), "timing_ms"),
    "tensor renamed": (first_output(name="paths"), "trajectories: expected"),
}


@pytest.mark.parametrize(("edit", "words"), BAD_ANSWERS.values(), ids=BAD_ANSWERS)
def test_an_answer_that_lies_is_invalid(edit: Edit, words: str) -> None:
    assert_invalid_answer(edited(ANSWER, edit), words)


def test_an_answer_of_strange_numbers_is_invalid() -> None:
    body, length = ANSWER.body, ANSWER.header_length or 0
    not_finite = np.array([np.nan], "<f4").tobytes()

    assert_invalid_answer(Payload(body[:-1] + b"\x02", length), "safe: expected bytes of 0")
    swapped = body[:length] + not_finite + body[length + 4 :]
    assert_invalid_answer(Payload(swapped, length), "not finite")


def mutated(payload: Payload, generator: np.random.Generator) -> Payload:
    """Change, remove, double or insert a few bytes, and sometimes change the header length."""
    body, length = bytearray(payload.body), payload.header_length or 0
    for _ in range(generator.integers(1, 3)):
        # Half of the hits go to the header, which is what a reader might believe.
        end = length if generator.random() < 0.5 else len(body)
        at = int(generator.integers(0, max(min(end, len(body)), 1)))
        run = int(generator.integers(1, 9))
        match generator.integers(0, 6):
            case 0:
                body[at : at + run] = generator.bytes(run)
            case 1:
                del body[at : at + run]
            case 2:
                body[at:at] = body[at : at + run]
            case _:  # the likeliest: one character of JSON for another
                body[at : at + 1] = b'0123456789-,:[]{}"ex.\x00\xff'[run : run + 1]
    if generator.random() < 0.2:
        length += int(generator.integers(-70, 70))
    return Payload(bytes(body), length)


@pytest.mark.parametrize("seed", range(4))
def test_mutated_bodies_are_read_or_refused(seed: int) -> None:
    generator = np.random.default_rng(seed)
    outcomes = {"request read": 0, "answer read": 0, "answer refused": 0}
    fields: list[str | None] = []

    for _ in range(1000):
        try:
            CODEC.decode_request(mutated(REQUEST, generator))
            outcomes["request read"] += 1
        except InvalidRequest as error:
            fields.append(error.field)
        try:
            CODEC.decode_answer(mutated(ANSWER, generator))
            outcomes["answer read"] += 1
        except InvalidAnswer:
            outcomes["answer refused"] += 1

    assert all(fields)
    # Both ways are taken: a mutation that always breaks, or never, would show nothing.
    assert min(len(fields), *outcomes.values()) > 20, outcomes


def test_reading_costs_no_more_than_the_body_pays_for() -> None:
    """A map of 4 MiB: what is allocated beside the body is less than the body."""
    payload = pack({}, "inputs", TENSORS | {"cost_map": np.zeros((4, 512, 512), F32)})
    told = b'"shape":[4,512,512]'
    lying = Payload(payload.body.replace(told, b'"shape":[9,999,999]'), payload.header_length)
    CODEC.decode_request(payload)

    tracemalloc.start()
    try:
        CODEC.decode_request(payload)
        _, honest = tracemalloc.get_traced_memory()
        tracemalloc.reset_peak()
        with pytest.raises(InvalidRequest, match="cost_map: expected 35928036 bytes"):
            CODEC.decode_request(lying)
        _, refused = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()

    assert honest < len(payload.body)
    assert refused < 2**20
