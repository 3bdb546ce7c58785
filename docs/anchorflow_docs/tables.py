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
    """From the outermost object, with dots."""
    kind: str = ""
    """Its shape, where it is an array; else its type, or the values to choose from."""
    allowed: str = ""
    """An interval with its unit; empty where the kind says all."""
    value: str = ""
    """What it holds, or holds by default."""
    meaning: str = ""


def field_table(fields: Iterable[Field], columns: Mapping[str, str]) -> str:
    """Markdown of the fields, with these columns."""
    rows = (
        [code(field.path), *(getattr(field, name) for name in columns if name != "path")]
        for field in fields
    )
    return table(list(columns.values()), rows)


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table whose cells may hold line breaks and bars."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join("| " + " | ".join(map(_cell, line)) + " |" for line in lines)


def code(text: str) -> str:
    """Text as it would be typed."""
    return f"`{text}`"


def _cell(text: str) -> str:
    """On one line; a bar outside of code would end the cell."""
    pieces = " ".join(text.split()).split("`")
    pieces[::2] = [piece.replace("|", r"\|") for piece in pieces[::2]]
    return "`".join(pieces)


def first_paragraph(thing: Any) -> str:
    """Of its docstring, on one line."""
    text = inspect.getdoc(thing)
    if not text:
        raise ValueError(f"{thing.__name__}: expected a docstring")
    return " ".join(text.partition("\n\n")[0].split())


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
