"""`GET /v2…`: health, what this server is, and the cards of its models."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

from fastapi import APIRouter
from starlette.responses import Response

from anchorflow_service.http.answers import json_answer
from anchorflow_service.http.openapi import MODELS_DOCUMENTATION, NOT_READY_DOCUMENTATION
from anchorflow_service.planning import PlanningService

SERVER_NAME = "anchorflow"
EXTENSIONS = ["binary_tensor_data", "model_repository"]
"""Extensions of the Open Inference Protocol that are spoken here."""


def server_router(service: PlanningService) -> APIRouter:
    """The routes, over the service."""
    router = APIRouter(prefix="/v2", tags=["server"])

    @router.get("")
    async def server() -> Response:
        """Name, version and protocol extensions of this server."""
        answer = {"name": SERVER_NAME, "version": server_version(), "extensions": EXTENSIONS}
        return json_answer(answer)

    @router.get("/health/live")
    async def live() -> Response:
        """Whether the process answers."""
        return json_answer({"live": True})

    @router.get("/health/ready", **NOT_READY_DOCUMENTATION)
    async def ready() -> Response:
        """Whether requests are taken now."""
        service.check_ready()
        return json_answer({"ready": True})

    @router.get("/models", **MODELS_DOCUMENTATION)
    async def models() -> Response:
        """The cards of all models, the default first."""
        cards = [card.to_dict() | {"ready": service.is_ready} for card in service.engines.cards()]
        return json_answer({"models": cards})

    return router


def server_version() -> str:
    """Of the installed distribution; a checkout on the path alone has none."""
    try:
        return version("anchorflow")
    except PackageNotFoundError:
        return "unknown"
