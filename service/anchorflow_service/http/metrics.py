"""`GET /metrics`: what Prometheus scrapes."""

from __future__ import annotations

import asyncio

from fastapi import APIRouter
from starlette.responses import Response

from anchorflow_service.observability.metrics import Metrics

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"


def metrics_router(metrics: Metrics) -> APIRouter:
    """The route, over the metrics."""
    router = APIRouter(tags=["server"])

    @router.get("/metrics", response_class=Response)
    async def scrape() -> Response:
        """Metrics in the text format of Prometheus."""
        return Response(
            await asyncio.to_thread(metrics.render), headers={"Content-Type": CONTENT_TYPE}
        )

    return router
