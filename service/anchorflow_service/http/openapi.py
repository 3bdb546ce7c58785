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
    TooLarge,
    UnknownModel,
)
from anchorflow_service.http.schemas import (
    AnchorAnswerBody,
    AnchorRequestBody,
    ErrorBody,
    ModelsBody,
)

REF_TEMPLATE = "#/components/schemas/{model}"


def _refusals(*errors: type[RequestError]) -> dict[int | str, dict[str, Any]]:
    return {
        error.http_status: {"model": ErrorBody, "description": f"`{error.code}`"}
        for error in errors
    }


def _request_body(model: type[BaseModel]) -> dict[str, Any]:
    schema = {"$ref": REF_TEMPLATE.format(model=model.__name__)}
    content = {"application/json": {"schema": schema}}
    return {"requestBody": {"required": True, "content": content}}


ANCHORS_DOCUMENTATION: dict[str, Any] = {
    "openapi_extra": _request_body(AnchorRequestBody),
    "responses": {200: {"model": AnchorAnswerBody}}
    | _refusals(
        InvalidRequest,
        UnknownModel,
        TooLarge,
        Overloaded,
        DeadlineExceeded,
        NotReady,
        InternalError,
    ),
}
MODELS_DOCUMENTATION: dict[str, Any] = {"responses": {200: {"model": ModelsBody}}}
NOT_READY_DOCUMENTATION: dict[str, Any] = {"responses": _refusals(NotReady)}


def document(app: FastAPI) -> None:
    """Make the app's schema hold the request's, which no route's signature names."""

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            schema = get_openapi(
                title=app.title, version=app.version, summary=app.summary, routes=app.routes
            )
            schema["components"]["schemas"] |= _definitions(AnchorRequestBody)
            app.openapi_schema = schema
        return app.openapi_schema

    app.openapi = openapi


def _definitions(model: type[BaseModel]) -> dict[str, Any]:
    """JSON schemas of a model and of all that it refers to, by name."""
    schema = model.model_json_schema(ref_template=REF_TEMPLATE)
    return schema.pop("$defs", {}) | {model.__name__: schema}
