"""The fields of a pydantic model as Python has them: type, range, default, the words under each."""

from __future__ import annotations

import re
from typing import Any, get_type_hints

from annotated_types import Ge, Gt, Le, Lt
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from anchorflow_docs.dataclass_fields import field_docstrings, first_paragraph
from anchorflow_docs.field_table import Field, field_table
from anchorflow_docs.markdown import code

HEADS = {
    "path": "field",
    "kind": "type",
    "allowed": "range",
    "value": "default",
    "meaning": "meaning",
}
MODULE = re.compile(r"\b[a-z_]\w*(?:\.[a-z_]\w*)*\.(?=[A-Z])")
"""In front of a class, where Python writes a type."""
OPTIONAL = re.compile(r"^Optional\[(.*)\]$")
SIGNS: dict[type, tuple[str, str]] = {
    Gt: (">", "gt"),
    Ge: ("≥", "ge"),
    Lt: ("<", "lt"),
    Le: ("≤", "le"),
}


def model_section(kind: type[BaseModel]) -> str:
    """Markdown of a model: a heading, what it is, and its fields."""
    said, types = field_docstrings(kind), get_type_hints(kind)
    rows = [
        Field(
            name,
            kind=code(_typed(types[name])),
            allowed=", ".join(_bounds(info)),
            value=_default(info),
            meaning=said.get(name, ""),
        )
        for name, info in kind.model_fields.items()
    ]
    return "\n\n".join([f"## {kind.__name__}", first_paragraph(kind), field_table(rows, HEADS)])


def _typed(kind: Any) -> str:
    """As it would be typed."""
    plain = kind.__name__ if isinstance(kind, type) else MODULE.sub("", str(kind))
    return OPTIONAL.sub(r"\1 | None", plain)


def _bounds(info: FieldInfo) -> list[str]:
    known = [(SIGNS[type(each)], each) for each in info.metadata if type(each) in SIGNS]
    return [f"{sign} {getattr(bound, name):g}" for (sign, name), bound in known]


def _default(info: FieldInfo) -> str:
    if info.is_required():
        return "required"
    return code(repr(info.get_default(call_default_factory=True)))
