"""Thousands of damaged binary bodies, and the price of reading one."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest

from anchorflow_client import AnchorBatch, InvalidAnswer, InvalidRequest, ModelId, OipCodec, Payload
from anchorflow_client.oip_message import pack

CODEC = OipCodec()
F32 = np.float32
Mutate = Callable[[Payload, np.random.Generator], Payload]
TENSORS: dict[str, np.ndarray] = {
    "x_curr": np.array([-3, 0.5, 0, 0, 0, 0]),
    "x_goal": np.array([3, 0.5, 0, 0]),
    "cost_map": np.zeros((1, 16, 20), F32),
    "map_geometry": np.array([-5, -4, 0.5], F32),
}
REQUEST = pack({"id": "r1", "parameters": {"seed": 1, "num_samples": 4}}, "inputs", TENSORS)


def answer() -> Payload:
    paths = np.arange(12, dtype=F32).reshape(2, 3, 2)
    batch = AnchorBatch(
        arrays={
            "trajectories": paths,
            "velocities": paths,
            "accelerations": paths,
            "scores": np.zeros(2, F32),
            "clearance": np.ones(2, F32),
            "safe": np.array([True, False]),
        },
        dt=0.1,
        seed=1,
        model=ModelId("lines", "1", "ab"),
        timing_ms={"total": 1.0},
    )
    return CODEC.encode_answer(batch)


@pytest.mark.parametrize("seed", range(4))
def test_mutated_bodies_are_read_or_refused(seed: int, mutated: Mutate) -> None:
    generator = np.random.default_rng(seed)
    outcomes = {"request read": 0, "answer read": 0, "answer refused": 0}
    fields: list[str | None] = []
    good = answer()

    for _ in range(1000):
        try:
            CODEC.decode_request(mutated(REQUEST, generator))
            outcomes["request read"] += 1
        except InvalidRequest as error:
            fields.append(error.field)
        try:
            CODEC.decode_answer(mutated(good, generator))
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
