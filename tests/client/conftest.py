"""A valid request and a card, which the tests change, and async clients as blocking ones."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from blocking_twin import Blocking
from staged_planner import Stage
from straight_lines import CARD, FREE_CARD

from anchorflow_client import (
    AnchorClient,
    AsyncAnchorClient,
    ModelCard,
    Transport,
)
from anchorflow_client.http.transport import HttpAnswer
from anchorflow_client.planner import PlannerConfig


@pytest.fixture
def fields() -> dict[str, Any]:
    """Return the JSON fields of a request on a free map of 16 x 20 cells, 0.5 m each."""
    return {
        "cost_map": {"data": np.zeros((1, 16, 20)).tolist(), "resolution": 0.5},
        "x_curr": [-3.0, 0.5, 0.0, 0.0, 0.0, 0.0],
        "x_goal": [3.0, 0.5, 0.0, 0.0],
    }


@pytest.fixture
def card() -> ModelCard:
    """Return a card that lets only robot_radius change."""
    conditioning = replace(CARD.cost_map, ranges={"robot_radius": (0.1, 0.6)})
    return replace(CARD, conditioning=conditioning, quality={"any": 0.9})


@pytest.fixture
def free() -> ModelCard:
    """Return a card whose anchors have their own durations, and whose limits can all be set."""
    ranges: dict[Any, tuple[float, float]] = {
        "robot_radius": (0.1, 0.6),
        "v_max": (0.1, 6.0),
        "a_max": (0.5, 8.0),
        "horizon_s": (1.0, 60.0),
    }
    return replace(FREE_CARD, conditioning=replace(FREE_CARD.cost_map, ranges=ranges))


@pytest.fixture
def stage() -> Stage:
    """Return a planner whose answers the test controls."""
    return Stage(PlannerConfig(max_age_ms=1000.0, period_ms=100.0, cold_every=3))


@pytest.fixture
def blocking() -> Iterator[Callable[[Any], Any]]:
    """Runs an async client or transport on a loop, one call at a time."""
    loop = asyncio.new_event_loop()
    yield lambda twin: Blocking(twin, loop)
    loop.close()


class AsyncTwin:
    """A blocking transport with the interface of an async one."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    async def send(self, *sent: Any, **_: Any) -> HttpAnswer:
        return self._transport.send(*sent)

    async def aclose(self) -> None:
        self._transport.close()


@pytest.fixture
def async_twin() -> Callable[[Transport], AsyncTwin]:
    """Wraps a blocking transport that never waits."""
    return AsyncTwin


@pytest.fixture(params=["blocking", "async"])
def make_client(request: pytest.FixtureRequest, blocking: Callable[[Any], Any]) -> Any:
    """Makes the blocking or the async client of a blocking transport."""

    def make(url: str, *, transport: Any, **options: Any) -> Any:
        if request.param == "blocking":
            return AnchorClient(url, transport=transport, **options)
        return blocking(AsyncAnchorClient(url, transport=AsyncTwin(transport), **options))

    return make
