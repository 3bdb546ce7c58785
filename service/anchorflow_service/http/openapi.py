"""What /openapi.json says of routes whose bodies are read and written by hand."""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic import BaseModel

from anchorflow_client.errors import (
    DeadlineExceeded,
    InternalError,
    InvalidRequest,
    NotReady,
    Overloaded,
    RequestError,
    Superseded,
    TooLarge,
    UnknownModel,
)
from anchorflow_service.http.oip_schemas import (
    IndexRequestBody,
    InferAnswerBody,
    InferRequestBody,
    LoadRequestBody,
    ModelMetadataBody,
    ModelReadyBody,
    ModelStateBody,
    UnloadRequestBody,
)
from anchorflow_service.http.request_schema import request_schema
from anchorflow_service.http.schemas import AnchorAnswerBody, ErrorBody, ModelsBody

REF_TEMPLATE = "#/components/schemas/{model}"
ANCHOR_REQUEST = "AnchorRequestBody"
HEADER_LENGTH = "Inference-Header-Content-Length"
_LENGTH = {
    "description": "Bytes of the JSON header in front of the tensors; with the binary form only.",
    "schema": {"type": "integer", "minimum": 1},
}
BINARY = {
    "type": "string",
    "format": "binary",
    "description": "Open Inference Protocol v2 with the binary tensor extension: a JSON header of "
    f"{HEADER_LENGTH} bytes, then the tensors. Arrays are tensors, other fields are parameters "
    "by their JSON path.",
}


def _refusals(*errors: type[RequestError]) -> dict[int | str, dict[str, Any]]:
    return {
        error.http_status: {"model": ErrorBody, "description": f"`{error.code}`"}
        for error in errors
    }


def _content(name: str) -> dict[str, Any]:
    """Return both forms of a body: the JSON schema of that name, and the same in binary."""
    json_form = {"schema": {"$ref": REF_TEMPLATE.format(model=name)}}
    return {"application/json": json_form, "application/octet-stream": {"schema": BINARY}}


def _planning(request: str, answer: type[BaseModel]) -> dict[str, Any]:
    """A route that plans, with bodies in both forms."""
    return {
        "openapi_extra": {
            "requestBody": {"required": True, "content": _content(request)},
            "parameters": [{"name": HEADER_LENGTH, "in": "header", **_LENGTH}],
        },
        "responses": {
            200: {
                "model": answer,
                "content": _content(answer.__name__),
                "headers": {HEADER_LENGTH: _LENGTH},
            }
        }
        | _refusals(
            InvalidRequest,
            UnknownModel,
            Superseded,
            TooLarge,
            Overloaded,
            DeadlineExceeded,
            NotReady,
            InternalError,
        ),
    }


def _administration(request: type[BaseModel], answer: Any) -> dict[str, Any]:
    """A route of the repository; its body may be left out."""
    schema = {"$ref": REF_TEMPLATE.format(model=request.__name__)}
    body = {"required": False, "content": {"application/json": {"schema": schema}}}
    return {
        "openapi_extra": {"requestBody": body},
        "responses": {200: {"model": answer}} | _refusals(InvalidRequest, UnknownModel, TooLarge),
    }


ANCHORS_DOCUMENTATION = _planning(ANCHOR_REQUEST, AnchorAnswerBody)
INFER_DOCUMENTATION = _planning(InferRequestBody.__name__, InferAnswerBody)
METADATA_DOCUMENTATION: dict[str, Any] = {
    "responses": {200: {"model": ModelMetadataBody}} | _refusals(UnknownModel)
}
MODEL_READY_DOCUMENTATION: dict[str, Any] = {
    "responses": {200: {"model": ModelReadyBody}} | _refusals(UnknownModel, NotReady)
}
INDEX_DOCUMENTATION = _administration(IndexRequestBody, list[ModelStateBody])
LOAD_DOCUMENTATION = _administration(LoadRequestBody, ModelStateBody)
UNLOAD_DOCUMENTATION = _administration(UnloadRequestBody, ModelStateBody)
MODELS_DOCUMENTATION: dict[str, Any] = {"responses": {200: {"model": ModelsBody}}}
NOT_READY_DOCUMENTATION: dict[str, Any] = {"responses": _refusals(NotReady)}
REQUESTS = (
    InferRequestBody,
    IndexRequestBody,
    LoadRequestBody,
    UnloadRequestBody,
)
"""What no route's signature names."""


def document(app: FastAPI) -> None:
    """Make the app's schema hold those of the requests."""

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            schema = get_openapi(
                title=app.title, version=app.version, summary=app.summary, routes=app.routes
            )
            schema["components"]["schemas"][ANCHOR_REQUEST] = request_schema()
            for model in REQUESTS:
                schema["components"]["schemas"] |= _definitions(model)
            app.openapi_schema = schema
        return app.openapi_schema

    app.openapi = openapi


def _definitions(model: type[BaseModel]) -> dict[str, Any]:
    """JSON schemas of a model and of all that it refers to, by name."""
    schema = model.model_json_schema(ref_template=REF_TEMPLATE)
    return schema.pop("$defs", {}) | {model.__name__: schema}
