"""A request on its way, and the answer that came of one."""

from __future__ import annotations

from concurrent import futures
from typing import NamedTuple

from anchorflow_client.contract import AnchorBatch
from anchorflow_client.planner.routes import Routes


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
