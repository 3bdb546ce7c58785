"""What a service answers: its paths, out of its own OpenAPI document, and its errors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from anchorflow_client.errors import RequestError, TransportError
from anchorflow_docs.dataclass_fields import first_paragraph
from anchorflow_docs.markdown import code, table


def endpoints(openapi: Mapping[str, Any]) -> str:
    """Every method of every path: what it does, and with which statuses it answers."""
    rows = [
        [
            code(f"{method.upper()} {path}"),
            operation.get("description", operation["summary"]).partition("\n\n")[0],
            ", ".join(sorted(operation["responses"], key=int)),
        ]
        for path, methods in openapi["paths"].items()
        for method, operation in methods.items()
    ]
    return table(["", "what it does", "statuses"], rows)


def refusals() -> str:
    """What a service may answer, by code and HTTP status."""
    kinds = sorted(RequestError.__subclasses__(), key=lambda kind: kind.http_status)
    rows = [
        [code(kind.code), str(kind.http_status), code(kind.__name__), first_paragraph(kind)]
        for kind in kinds
    ]
    return table(["code", "HTTP status", "class", "when"], rows)


def failures() -> str:
    """What a client raises where no answer of the contract comes."""
    rows = [
        [code(kind.__name__), first_paragraph(kind)] for kind in TransportError.__subclasses__()
    ]
    return table(["class", "when"], rows)
