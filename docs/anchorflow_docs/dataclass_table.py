"""A dataclass as a table: every field with its type, its default and the words under it."""

from __future__ import annotations

import ast
import inspect
from dataclasses import MISSING, Field, fields, is_dataclass
from textwrap import dedent
from typing import Any

from anchorflow_docs.markdown import code, table


def dataclass_section(kind: type) -> str:
    """Markdown of a dataclass: a heading, what it is, its fields and its properties."""
    said = field_docstrings(kind)
    parts = [f"## {kind.__name__}", first_paragraph(kind)]
    rows = [
        [code(field.name), code(str(field.type)), default_of(field), said.get(field.name, "")]
        for field in fields(kind)
    ]
    parts.append(table(["field", "type", "default", "meaning"], rows))
    if own := properties(kind):
        parts.append(table(["property", "type", "meaning"], own))
    return "\n\n".join(parts)


def first_paragraph(thing: Any) -> str:
    """Of its docstring, on one line."""
    text = inspect.getdoc(thing)
    if not text:
        raise ValueError(f"{thing.__name__}: expected a docstring")
    return " ".join(text.partition("\n\n")[0].split())


def field_docstrings(kind: type) -> dict[str, str]:
    """The string that stands under each field of a dataclass, those it inherits included."""
    said: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        if is_dataclass(base):
            said |= _own_docstrings(base)
    return said


def _own_docstrings(kind: type) -> dict[str, str]:
    (tree,) = ast.parse(dedent(inspect.getsource(kind))).body
    assert isinstance(tree, ast.ClassDef)
    said = {}
    for before, after in zip(tree.body, tree.body[1:], strict=False):
        match before, after:
            case (
                ast.AnnAssign(target=ast.Name(id=name)),
                ast.Expr(value=ast.Constant(value=str(text))),
            ):
                said[name] = inspect.cleandoc(text)
    return said


def default_of(field: Field[Any]) -> str:
    """As it would be typed; "required" where there is none."""
    if field.default is not MISSING:
        return code(repr(field.default))
    if field.default_factory is not MISSING:
        return code(repr(field.default_factory()))
    return "required"


def properties(kind: type) -> list[list[str]]:
    """Name, type and meaning of what is worked out of the fields."""
    rows = []
    for name, member in inspect.getmembers(kind, lambda member: isinstance(member, property)):
        assert member.fget is not None
        returns = inspect.signature(member.fget).return_annotation
        rows.append([code(name), code(str(returns)), first_paragraph(member)])
    return rows
