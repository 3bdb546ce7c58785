"""`POST /v2/repository/…`: the bundles that there are, loaded and unloaded while requests come."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from anchorflow_client.contract.checks import boolean, fields_of, text
from anchorflow_client.errors import InvalidRequest
from anchorflow_service.http.answers import json_answer
from anchorflow_service.http.body import read_body
from anchorflow_service.http.openapi import (
    INDEX_DOCUMENTATION,
    LOAD_DOCUMENTATION,
    UNLOAD_DOCUMENTATION,
)
from anchorflow_service.http.orjson_codec import parse
from anchorflow_service.repository import LoadError, Repository
from anchorflow_service.repository.repository import READY, UNAVAILABLE

MAX_BODY_BYTES = 64 * 1024


def repository_router(repository: Repository) -> APIRouter:
    """The routes of the protocol's model repository extension."""
    router = APIRouter(prefix="/v2/repository", tags=["repository"])

    @router.post("/index", **INDEX_DOCUMENTATION)
    async def index(request: Request) -> Response:
        """Every version of every model, whether it is served, and why not."""
        asked = await _fields(request, ("ready",))
        only_ready = boolean(asked.get("ready", False), "ready")
        states = await asyncio.to_thread(repository.index)
        return json_answer(
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
        return _told(name, card.version, READY)

    @router.post("/models/{name}/unload", **UNLOAD_DOCUMENTATION)
    async def unload_model(name: str, request: Request) -> Response:
        """Serve a model no longer; requests that have been taken are still answered."""
        parameters = await _parameters(request, ("unload_dependents",))
        boolean(parameters.get("unload_dependents", False), "parameters.unload_dependents")
        await asyncio.to_thread(repository.unload, name)
        return _told(name, "", UNAVAILABLE)

    return router


def _told(name: str, version: str, state: str) -> Response:
    return json_answer({"name": name, "version": version, "state": state, "reason": ""})


async def _parameters(request: Request, known: tuple[str, ...]) -> Mapping[str, Any]:
    fields = await _fields(request, ("parameters",))
    given = fields.get("parameters")
    return {} if given is None else fields_of(given, "parameters", known)


async def _fields(request: Request, known: tuple[str, ...]) -> Mapping[str, Any]:
    """The fields of a body of JSON, which may be left out."""
    body = await read_body(request, MAX_BODY_BYTES)
    return fields_of(parse(body), "", known) if body else {}
