"""`GET /v2…`, `GET /metrics` and `POST /v2/repository/…`: the server, its health and its models."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from anchorflow_client.contract.checks import boolean, fields_of, text
from anchorflow_client.errors import InvalidRequest
from anchorflow_service.http.exchanges import read_body
from anchorflow_service.http.openapi import (
    INDEX_DOCUMENTATION,
    LOAD_DOCUMENTATION,
    MODELS_DOCUMENTATION,
    NOT_READY_DOCUMENTATION,
    UNLOAD_DOCUMENTATION,
)
from anchorflow_service.http.orjson_codec import parse
from anchorflow_service.http.responses import json_response
from anchorflow_service.observability.metrics import Metrics
from anchorflow_service.planning import PlanningService
from anchorflow_service.repository import READY, UNAVAILABLE, LoadError, Repository

SERVER_NAME = "anchorflow"
EXTENSIONS = ["binary_tensor_data", "model_repository"]
"""Extensions of the Open Inference Protocol that this server speaks."""
METRICS_CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
MAX_BODY_BYTES = 64 * 1024
"""Limit for requests to the repository."""


def server_version() -> str:
    """Return the version of the installed distribution; a mere checkout has none."""
    try:
        return version("anchorflow")
    except PackageNotFoundError:
        return "unknown"


def server_router(service: PlanningService) -> APIRouter:
    router = APIRouter(prefix="/v2", tags=["server"])

    @router.get("")
    async def server() -> Response:
        """Name, version and protocol extensions of this server."""
        about = {"name": SERVER_NAME, "version": server_version(), "extensions": EXTENSIONS}
        return json_response(about)

    @router.get("/health/live")
    async def live() -> Response:
        """Whether the process answers."""
        return json_response({"live": True})

    @router.get("/health/ready", **NOT_READY_DOCUMENTATION)
    async def ready() -> Response:
        """Whether requests are taken now."""
        service.check_ready()
        return json_response({"ready": True})

    @router.get("/models", **MODELS_DOCUMENTATION)
    async def models() -> Response:
        """The cards of all models, the default first."""
        cards = [card.to_dict() | {"ready": service.is_ready} for card in service.engines.cards()]
        return json_response({"models": cards})

    return router


def metrics_router(metrics: Metrics) -> APIRouter:
    router = APIRouter(tags=["server"])

    @router.get("/metrics", response_class=Response)
    async def scrape() -> Response:
        """Metrics in the text format of Prometheus."""
        text_format = await asyncio.to_thread(metrics.render)
        return Response(text_format, headers={"Content-Type": METRICS_CONTENT_TYPE})

    return router


def repository_router(repository: Repository) -> APIRouter:
    router = APIRouter(prefix="/v2/repository", tags=["repository"])

    @router.post("/index", **INDEX_DOCUMENTATION)
    async def index(request: Request) -> Response:
        """Every version of every model, whether it is served, and why not."""
        asked = await _fields(request, ("ready",))
        only_ready = boolean(asked.get("ready", False), "ready")
        states = await asyncio.to_thread(repository.index)
        return json_response(
            [asdict(each) for each in states if not only_ready or each.state == READY]
        )

    @router.post("/models/{name}/load", **LOAD_DOCUMENTATION)
    async def load_model(name: str, request: Request) -> Response:
        """Read a model's bundle from its folder and serve it, in place of one that does."""
        parameters = await _parameters(request, ("version",))
        version = parameters.get("version")
        version = version if version is None else text(version, "parameters.version")
        try:
            card = await asyncio.to_thread(repository.load, name, version)
        except LoadError as error:
            raise InvalidRequest(f"{name} was not taken: {error}") from error
        return _state(name, card.version, READY)

    @router.post("/models/{name}/unload", **UNLOAD_DOCUMENTATION)
    async def unload_model(name: str, request: Request) -> Response:
        """Serve a model no longer; requests that have been taken are still answered."""
        parameters = await _parameters(request, ("unload_dependents",))
        boolean(parameters.get("unload_dependents", False), "parameters.unload_dependents")
        await asyncio.to_thread(repository.unload, name)
        return _state(name, "", UNAVAILABLE)

    return router


def _state(name: str, version: str, state: str) -> Response:
    return json_response({"name": name, "version": version, "state": state, "reason": ""})


async def _parameters(request: Request, known: tuple[str, ...]) -> Mapping[str, Any]:
    given = (await _fields(request, ("parameters",))).get("parameters")
    return {} if given is None else fields_of(given, "parameters", known)


async def _fields(request: Request, known: tuple[str, ...]) -> Mapping[str, Any]:
    """Return the fields of a JSON body, which may be empty."""
    body = await read_body(request, MAX_BODY_BYTES)
    return fields_of(parse(body), "", known) if body else {}
