"""The fields of a thing as a table, whatever it is: a schema, a dataclass, one instance of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from anchorflow_docs.markdown import code, table

SENT = {
    "path": "field",
    "kind": "type or shape",
    "allowed": "range, unit",
    "value": "default",
    "meaning": "meaning",
}
"""What is sent: the columns by the names of a `Field`, and their heads."""
ANSWERED = {"path": "field", "kind": "type or shape", "allowed": "unit", "meaning": "meaning"}
"""What comes back, where nothing has a default."""
TYPED = {"path": "field", "kind": "type", "value": "default", "meaning": "meaning"}
"""A class of Python."""
HELD = {"path": "field", "value": "value", "meaning": "meaning"}
"""One instance of it."""


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
