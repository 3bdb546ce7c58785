"""`/v2/models/{name}…`: a model's metadata, readiness and anchors.

This is the Open Inference Protocol (KServe's v2), so that any of its clients works.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from anchorflow_client.codec import Payload
from anchorflow_client.contract import CostMapSpec, ModelCard, TensorSpec
from anchorflow_client.contract.batch import ARRAY_DTYPES, MOTIONS
from anchorflow_client.errors import UnknownModel
from anchorflow_client.oip_codec import TIME_STEP
from anchorflow_client.oip_message import datatype_of
from anchorflow_service.http.anchors import answer_to, header_length
from anchorflow_service.http.exchanges import read_body
from anchorflow_service.http.infer_codec import InferCodec
from anchorflow_service.http.openapi import (
    INFER_DOCUMENTATION,
    METADATA_DOCUMENTATION,
    MODEL_READY_DOCUMENTATION,
)
from anchorflow_service.http.responses import json_response
from anchorflow_service.planning import Call, PlanningService

PLATFORM = "anchorflow_onnx"
ANY = -1
"""The size of an axis of any length."""


def models_router(service: PlanningService) -> APIRouter:
    """Return the routes; a version in the path must be the served one."""
    router = APIRouter(prefix="/v2/models", tags=["models"])

    def card_of(name: str, version: str | None) -> ModelCard:
        card = service.engines.choose(name).card
        if version not in (None, card.version):
            raise UnknownModel(f"expected version {card.version} of {name}, got {version}", "model")
        return card

    @router.get("/{name}", **METADATA_DOCUMENTATION)
    @router.get("/{name}/versions/{version}", **METADATA_DOCUMENTATION)
    async def metadata(name: str, version: str | None = None) -> Response:
        """The inputs and outputs of a model, for a batch of scenes."""
        return json_response(_metadata(card_of(name, version)))

    @router.get("/{name}/ready", **MODEL_READY_DOCUMENTATION)
    @router.get("/{name}/versions/{version}/ready", **MODEL_READY_DOCUMENTATION)
    async def ready(name: str, version: str | None = None) -> Response:
        """Whether a model takes requests now."""
        card_of(name, version)
        service.check_ready()
        return json_response({"name": name, "ready": True})

    @router.post("/{name}/infer", **INFER_DOCUMENTATION)
    @router.post("/{name}/versions/{version}/infer", **INFER_DOCUMENTATION)
    async def infer(request: Request, name: str, version: str | None = None) -> Response:
        """Anchors, each tensor in JSON or in binary, both ways."""
        arrival = service.arrival()
        body = await read_body(request, service.limits.max_body_bytes)
        card_of(name, version)
        payload = Payload(body, header_length(request))
        call = Call(payload, InferCodec(), arrival, request.state.request_id, model=name)
        return await answer_to(call, request, service)

    return router


def _metadata(card: ModelCard) -> dict[str, Any]:
    return {
        "name": card.name,
        "versions": [card.version],
        "platform": PLATFORM,
        "inputs": [_tensor(spec) for spec in (*card.inputs, *_choices(card))],
        "outputs": [*map(_tensor, _answer(card)), *map(_tensor, card.answer.extras)],
    }


def _choices(card: ModelCard) -> list[TensorSpec]:
    """Return the optional arrays of a request that are not inputs of the planner."""
    if not isinstance(card.conditioning, CostMapSpec):
        return []
    return [
        TensorSpec("warm_start", "float64", ("T", "S")),
        TensorSpec("schedule", "float64", ("K",)),
        TensorSpec("obstacle_position", "float64", ("M", 2)),
        TensorSpec("obstacle_velocity", "float64", ("M", 2)),
        TensorSpec("obstacle_radius", "float64", ("M",)),
        TensorSpec("obstacle_forecast", "float64", ("M", "K", 2)),
    ]


def _answer(card: ModelCard) -> list[TensorSpec]:
    motion = ("B", "N", card.T, card.D)
    arrays = [
        TensorSpec(name, np.dtype(dtype).name, motion if name in MOTIONS else ("B", "N"))
        for name, dtype in ARRAY_DTYPES.items()
        if name in card.answer.names
    ]
    own_time = card.time.dt is None
    return [*arrays, TensorSpec(TIME_STEP, "float64", ("B", "N"))] if own_time else arrays


def _tensor(spec: TensorSpec) -> dict[str, Any]:
    shape = [axis if isinstance(axis, int) else ANY for axis in spec.shape]
    return {"name": spec.name, "datatype": datatype_of(spec.dtype), "shape": shape}
