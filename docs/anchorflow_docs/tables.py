"""Tables in Markdown: fields, endpoints and errors."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from anchorflow_client.errors import RequestError, TransportError

SENT = {
    "path": "field",
    "kind": "type or shape",
    "allowed": "range, unit",
    "value": "default",
    "meaning": "meaning",
}
"""The columns for a request: heads by the names of a `Field`."""
ANSWERED = {"path": "field", "kind": "type or shape", "allowed": "unit", "meaning": "meaning"}
"""The columns for an answer, in which nothing has a default."""
TYPED = {"path": "field", "kind": "type", "value": "default", "meaning": "meaning"}
"""The columns for a Python class."""
HELD = {"path": "field", "value": "value", "meaning": "meaning"}
"""The columns for an instance."""


@dataclass(frozen=True)
class Field:
    """One field, in Markdown but for its path."""

    path: str
    """The JSON path."""
    kind: str = ""
    """The shape of an array, else the type or the allowed values."""
    allowed: str = ""
    """An interval with its unit, or empty."""
    value: str = ""
    """The value, or the default."""
    meaning: str = ""


def field_table(fields: Iterable[Field], columns: Mapping[str, str]) -> str:
    """Return the fields in Markdown, with these columns."""
    rows = (
        [code(field.path), *(getattr(field, name) for name in columns if name != "path")]
        for field in fields
    )
    return table(list(columns.values()), rows)


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown; cells may hold line breaks and bars."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join("| " + " | ".join(map(_cell, line)) + " |" for line in lines)


def code(text: str) -> str:
    return f"`{text}`"


def _cell(text: str) -> str:
    """Put a cell on one line and escape bars outside of code."""
    pieces = " ".join(text.split()).split("`")
    pieces[::2] = [piece.replace("|", r"\|") for piece in pieces[::2]]
    return "`".join(pieces)


def first_paragraph(thing: Any) -> str:
    """Return the first paragraph of a docstring on one line."""
    text = inspect.getdoc(thing)
    if not text:
        raise ValueError(f"{thing.__name__}: expected a docstring")
    return " ".join(text.partition("\n\n")[0].split())


def endpoints(openapi: Mapping[str, Any]) -> str:
    """List every method of every path, with its description and statuses."""
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
    """List the errors of a service by code and HTTP status."""
    kinds = sorted(RequestError.__subclasses__(), key=lambda kind: kind.http_status)
    rows = [
        [code(kind.code), str(kind.http_status), code(kind.__name__), first_paragraph(kind)]
        for kind in kinds
    ]
    return table(["code", "HTTP status", "class", "when"], rows)


def failures() -> str:
    """List the errors that a client raises without an answer of the contract."""
    rows = [
        [code(kind.__name__), first_paragraph(kind)] for kind in TransportError.__subclasses__()
    ]
    return table(["class", "when"], rows)
