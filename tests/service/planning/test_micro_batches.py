"""Concurrent requests to the default bundle get the bytes that each gets alone."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

import numpy as np
import pytest

from anchorflow_client import AnchorBatch, AnchorRequest, OipCodec
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_service.engine import Engine
from anchorflow_service.local import LocalClient
from anchorflow_service.planning import Call, Observer, PlanningService, ServiceLimits

CODEC = OipCodec()
CALLERS = 10


class Sizes(Observer):
    """Records the sizes of batches."""

    def __init__(self) -> None:
        self.seen: list[int] = []

    def batch_planned(self, requests: int) -> None:
        self.seen.append(requests)


@pytest.fixture(scope="module")
def engine() -> Engine:
    return Engine(load_bundle(DEFAULT_BUNDLE), threads=2)


def request(caller: int) -> AnchorRequest:
    """Another map, another way through it, another seed; the same sampler and N."""
    occupancy = np.zeros((1, 64, 64), np.float32)
    occupancy[0, 12 + 3 * caller : 18 + 3 * caller, 28:36] = 1.0
    return AnchorRequest.build(
        cost_map={"data": occupancy, "resolution": 0.16},
        x_curr=[-4.0, 0.3 * caller - 1.5, 0.4, 0.0, 0.0, 0.0],
        x_goal=[4.0, 1.5 - 0.3 * caller, 0.0, 0.0],
        num_samples=16,
        seed=caller,
        sampler={"method": "midpoint", "schedule": {"uniform": 2}},
    )


def answers(
    engine: Engine, limits: ServiceLimits, requests: Sequence[AnchorRequest]
) -> tuple[list[AnchorBatch], list[int]]:
    """Return the answers to concurrent requests, and the sizes of the batches."""
    service, sizes = PlanningService({"it": engine}, default="it", limits=limits), Sizes()
    service.watch(sizes)

    async def ask(asked: AnchorRequest) -> AnchorBatch:
        call = Call(CODEC.encode_request(asked), CODEC, service.arrival(), "r")
        return CODEC.decode_answer(await service.answer(call))

    async def ask_all() -> list[AnchorBatch]:
        return await asyncio.gather(*map(ask, requests))

    with service:
        return asyncio.run(ask_all()), sizes.seen


@pytest.mark.parametrize("threads", [1, 2, 4])
def test_together_they_get_the_bytes_that_each_gets_alone(engine: Engine, threads: int) -> None:
    requests = [request(caller) for caller in range(CALLERS)]
    # A map's geometry is float32 in binary, so single requests go through the codec too.
    alone = [LocalClient(engine).plan_request(each) for each in requests]

    together, sizes = answers(engine, ServiceLimits(threads=threads), requests)

    for one, other in zip(alone, together, strict=True):
        assert one.arrays.keys() == other.arrays.keys()
        for name, array in one.arrays.items():
            assert array.tobytes() == other.arrays[name].tobytes(), name
    assert sum(sizes) == CALLERS
    assert max(sizes) > 1
