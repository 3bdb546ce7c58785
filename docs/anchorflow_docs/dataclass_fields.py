"""The fields of a dataclass, or of one instance: type, default or value, the words under each."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import json
from collections.abc import Iterator
from textwrap import dedent
from typing import Any

from anchorflow_docs.field_table import TYPED, Field, field_table
from anchorflow_docs.markdown import code, table


def dataclass_section(kind: type) -> str:
    """Markdown of a dataclass: a heading, what it is, its fields and its properties."""
    parts = [f"## {kind.__name__}", first_paragraph(kind), field_table(class_fields(kind), TYPED)]
    if own := properties(kind):
        parts.append(table(["property", "type", "meaning"], own))
    return "\n\n".join(parts)


def class_fields(kind: type) -> list[Field]:
    """Its fields with their types and defaults."""
    said = field_docstrings(kind)
    return [
        Field(
            each.name,
            kind=code(str(each.type)),
            value=default_of(each),
            meaning=said.get(each.name, ""),
        )
        for each in dataclasses.fields(kind)
    ]


def held_fields(instance: Any, prefix: str = "") -> Iterator[Field]:
    """What an instance holds, and what is held inside it; lists of objects are left out."""
    said = field_docstrings(type(instance))
    for each in dataclasses.fields(instance):
        value, path = getattr(instance, each.name), prefix + each.name
        if dataclasses.is_dataclass(value):
            yield from held_fields(value, f"{path}.")
        elif (figure := _figure(value)) is not None:
            yield Field(path, value=figure, meaning=said.get(each.name, ""))


def _figure(value: Any) -> str | None:
    """As JSON has it, in four figures; None for what is no figure, word or list of them."""
    match value:
        case bool() | None:
            return code(json.dumps(value))
        case int() | float():
            return f"{value:.4g}" if isinstance(value, float) else str(value)
        case str():
            return code(value)
        case tuple() if all(isinstance(each, (str, int, float)) for each in value):
            return ", ".join(str(_figure(each)) for each in value)
        case dict() if value and all(isinstance(each, tuple) for each in value.values()):
            ends = {
                name: " to ".join(str(_figure(end)) for end in each) for name, each in value.items()
            }
            return "; ".join(f"{code(name)} {each}" for name, each in ends.items())
    return None


def first_paragraph(thing: Any) -> str:
    """Of its docstring, on one line."""
    text = inspect.getdoc(thing)
    if not text:
        raise ValueError(f"{thing.__name__}: expected a docstring")
    return " ".join(text.partition("\n\n")[0].split())


def field_docstrings(kind: type) -> dict[str, str]:
    """The string that stands under each field of a class, those it inherits included."""
    said: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        if "__annotations__" in vars(base):
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


def default_of(field: dataclasses.Field[Any]) -> str:
    """As it would be typed; "required" where there is none."""
    if field.default is not dataclasses.MISSING:
        return code(repr(field.default))
    if field.default_factory is not dataclasses.MISSING:
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
