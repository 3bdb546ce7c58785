"""What /openapi.json says of tokens, where they are asked for."""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI

from anchorflow_client.errors import Unauthorized
from anchorflow_service.http.guard import scopes_for
from anchorflow_service.http.openapi import REF_TEMPLATE
from anchorflow_service.http.schemas import ErrorBody

SCHEME = "token"
REFUSED = {
    "description": f"`{Unauthorized.code}`",
    "content": {
        "application/json": {
            "schema": {"$ref": REF_TEMPLATE.format(model=ErrorBody.__name__)},
        }
    },
}


def document_guard(app: FastAPI) -> None:
    """Make the app's schema say which of its routes need a token, and how they refuse."""
    schema = app.openapi()
    schemes = schema["components"].setdefault("securitySchemes", {})
    schemes[SCHEME] = {"type": "http", "scheme": "bearer"}
    for path, operations in schema["paths"].items():
        for method, operation in operations.items():
            if scopes_for(method.upper(), path):
                _document(operation)


def _document(operation: dict[str, Any]) -> None:
    operation["security"] = [{SCHEME: []}]
    operation["responses"][str(Unauthorized.http_status)] = REFUSED
