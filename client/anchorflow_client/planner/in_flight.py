"""Who is asked, a request on its way, and the answer that came of one."""

from __future__ import annotations

from concurrent import futures
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import AnchorBatch, AnchorRequest
from anchorflow_client.planner.routes import Routes

Array = NDArray[np.float64]


class AnchorSource(Protocol):
    """Whatever answers requests: `AnchorClient`, or another client of the same interface."""

    def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        """Blocks until there is an answer. Raises `AnchorFlowError` where there is none."""
        ...


class Judged(NamedTuple):
    """An answer as it came, and what its request tells of it."""

    batch: AnchorBatch
    routes: Routes
    v_max: float
    """m/s, of the robot; infinite where nothing tells it."""
    reason: str | None
    """Why nothing is safe; None where something is."""


class RequestInFlight(NamedTuple):
    """A request on its way."""

    request_id: str
    seen_at: float
    place: Array
    """[2] m, of the robot."""
    future: futures.Future[Judged]


class Answer(NamedTuple):
    """The newest good answer, and which of its anchors to follow."""

    request_id: str
    seen_at: float
    batch: AnchorBatch
    routes: Routes
    v_max: float
    reason: str | None
    best: int
