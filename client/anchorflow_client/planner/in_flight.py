"""Who is asked, a request on its way, and the answer that came of one."""

from __future__ import annotations

from concurrent import futures
from typing import NamedTuple, Protocol

from anchorflow_client.contract import AnchorBatch, AnchorRequest
from anchorflow_client.planner.routes import Routes


class AnchorSource(Protocol):
    """Whatever answers requests: `AnchorClient`, or another client of the same interface."""

    def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        """Blocks until there is an answer. Raises `AnchorFlowError` where there is none."""
        ...


class RequestInFlight(NamedTuple):
    """A request on its way; its answer comes with the routes of its anchors."""

    request_id: str
    seen_at: float
    future: futures.Future[tuple[AnchorBatch, Routes]]


class Answer(NamedTuple):
    """The newest good answer, and which of its anchors to follow."""

    request_id: str
    seen_at: float
    batch: AnchorBatch
    routes: Routes
    best: int
