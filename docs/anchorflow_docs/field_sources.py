"""Fields for the reference, from the contract's table, JSON schemas, dataclasses and models."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import json
import re
from collections.abc import Iterator, Mapping
from textwrap import dedent
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import pydantic.dataclasses
from annotated_types import Ge, Gt, Le, Lt
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from anchorflow_client.contract.checks import Interval
from anchorflow_client.contract.rows import Array, Group, Number, Row, Text
from anchorflow_docs.tables import TYPED, Field, code, field_table, first_paragraph, table

LARGEST_SEED = 2**63 - 1
SHAPE = re.compile(r"\[[^\]]+\]")
HEADS = {
    "path": "field",
    "kind": "type",
    "allowed": "range",
    "value": "default",
    "meaning": "meaning",
}
MODULE = re.compile(r"\b[a-z_]\w*(?:\.[a-z_]\w*)*\.(?=[A-Z])")
"""The modules before a class in a type's name."""
OPTIONAL = re.compile(r"^Optional\[(.*)\]$")
SIGNS: dict[type, str] = {Gt: ">", Ge: "≥", Lt: "<", Le: "≤"}


def request_fields(group: Group, prefix: str = "") -> Iterator[Field]:
    """Yield the fields of the contract's table by their JSON paths."""
    for name, row in group.fields.items():
        default = "" if row.default is None else code(json.dumps(row.default))
        yield Field(
            prefix + name,
            kind=_kind_of_row(row),
            allowed=_allowed(row),
            value="required" if row.required else default,
            meaning=_squared(row.meaning),
        )
        if isinstance(row, Group):
            yield from request_fields(row, f"{prefix}{name}.")


def _kind_of_row(row: Row) -> str:
    match row:
        case Array():
            shape = SHAPE.sub(r"`\g<0>`", row.shape)
            others = [code(json.dumps(word)) for word in row.words]
            others += [code(f'{{"{key}": …}}') for key in row.objects]
            return " or ".join([shape, *others])
        case Number():
            return "integer" if row.whole else "number"
        case Text():
            return ", ".join(code(json.dumps(option)) for option in row.options) or "string"
    return {"Flag": "boolean", "Names": "list of strings"}.get(type(row).__name__, "object")


def _allowed(row: Row) -> str:
    """Return the interval with its unit, or only the units of an array with several."""
    match row:
        case Number(interval=interval):
            return _squared(f"{_ends(interval)} {interval.unit}".strip())
        case Array(interval=interval, unit=unit):
            return _squared(unit or _ends(interval))
    return ""


def _ends(interval: Interval) -> str:
    left, right = "(" if interval.open_low else "[", ")" if interval.open_high else "]"
    high = "2⁶³ − 1" if interval.high == LARGEST_SEED else f"{interval.high:g}"
    return f"{left}{interval.low:g}, {high}{right}"


def _squared(text: str) -> str:
    return text.replace("^2", "²")


def schema_fields(model: type[BaseModel]) -> list[Field]:
    """Return the fields of an answer's model, and of those inside it."""
    schema = model.model_json_schema()
    return list(_schema_fields(schema, schema.get("$defs", {}), ""))


def _schema_fields(
    schema: Mapping[str, Any], definitions: Mapping[str, Any], prefix: str
) -> Iterator[Field]:
    for name, field in schema.get("properties", {}).items():
        choices = [
            definitions[choice["$ref"].rpartition("/")[2]] if "$ref" in choice else choice
            for choice in field.get("anyOf", [field])
        ]
        kinds = (_kind_of_schema(choice) for choice in choices if choice.get("type") != "null")
        own_words = choices[0].get("description", "").partition("\n")[0]
        yield Field(
            prefix + name,
            kind=SHAPE.sub(r"`\g<0>`", field.get("x-shape", "")) or " or ".join(kinds),
            allowed=_squared(field.get("x-unit", "")),
            meaning=_squared(own_words or field.get("description", "")),
        )
        for choice in choices:
            yield from _schema_fields(choice, definitions, f"{prefix}{name}.")


def _kind_of_schema(choice: Mapping[str, Any]) -> str:
    match choice:
        case {"enum": [*values]}:
            return ", ".join(code(json.dumps(value)) for value in values)
        case {"type": str(kind)}:
            return kind
    raise ValueError(f"expected a type or an enumeration, got {choice}")


def dataclass_section(kind: type) -> str:
    """Return a dataclass in Markdown: heading, description, fields and properties."""
    parts = [f"## {kind.__name__}", first_paragraph(kind), field_table(class_fields(kind), TYPED)]
    if own := properties(kind):
        parts.append(table(["property", "type", "meaning"], own))
    return "\n\n".join(parts)


def class_fields(kind: type) -> list[Field]:
    """Return a dataclass's fields with their types and defaults."""
    said = field_docstrings(kind)
    rows = []
    for each in dataclasses.fields(kind):
        plain, meaning = each.type, said.get(each.name, "")
        if get_origin(plain) is Annotated:  # a row of the contract's table
            plain, row = get_args(plain)
            meaning = row.meaning
        name = plain.__name__ if isinstance(plain, type) else str(plain).replace("typing.", "")
        name = "NDArray[np.float64]" if "ndarray" in name else name
        rows.append(Field(each.name, kind=code(name), value=default_of(each), meaning=meaning))
    return rows


def held_fields(instance: Any, prefix: str = "") -> Iterator[Field]:
    """Yield an instance's values, nested dataclasses included; lists of objects are left out."""
    said = field_docstrings(type(instance))
    for each in dataclasses.fields(instance):
        value, path = getattr(instance, each.name), prefix + each.name
        if dataclasses.is_dataclass(value):
            yield from held_fields(value, f"{path}.")
        elif (figure := _figure(value)) is not None:
            yield Field(path, value=figure, meaning=said.get(each.name, ""))


def _figure(value: Any) -> str | None:
    """Return a value as JSON, in four figures; None for objects and lists of objects."""
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


def field_docstrings(kind: type) -> dict[str, str]:
    """Return the docstring under each field of a class, inherited fields included."""
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
    """Return the default in Python; "required" if there is none."""
    if field.default is not dataclasses.MISSING:
        return code(repr(field.default))
    if field.default_factory is not dataclasses.MISSING:
        return code(repr(field.default_factory()))
    return "required"


def properties(kind: type) -> list[list[str]]:
    """Return name, type and meaning of each property."""
    rows = []
    for name, member in inspect.getmembers(kind, lambda member: isinstance(member, property)):
        assert member.fget is not None
        returns = inspect.signature(member.fget).return_annotation
        rows.append([code(name), code(str(returns)), first_paragraph(member)])
    return rows


def model_section(kind: type) -> str:
    """Markdown of a model or dataclass: a heading, what it is, and its fields."""
    said, types = field_docstrings(kind), get_type_hints(kind)
    checked = (
        kind if issubclass(kind, BaseModel) else pydantic.dataclasses.dataclass(kind, frozen=True)
    )
    found: dict[str, FieldInfo] = checked.__pydantic_fields__  # type: ignore[attr-defined]
    rows = [
        Field(
            name,
            kind=code(_typed(types[name])),
            allowed=", ".join(_bounds(info)),
            value=_default_of_model(info),
            meaning=said.get(name, ""),
        )
        for name, info in found.items()
    ]
    return "\n\n".join([f"## {kind.__name__}", first_paragraph(kind), field_table(rows, HEADS)])


def _typed(kind: Any) -> str:
    """Return a type in Python."""
    plain = kind.__name__ if isinstance(kind, type) else MODULE.sub("", str(kind))
    return OPTIONAL.sub(r"\1 | None", plain)


def _bounds(info: FieldInfo) -> list[str]:
    known = [(type(each), each) for each in info.metadata if type(each) in SIGNS]
    return [f"{SIGNS[kind]} {getattr(bound, kind.__name__.lower()):g}" for kind, bound in known]


def _default_of_model(info: FieldInfo) -> str:
    if info.is_required():
        return "required"
    return code(repr(info.get_default(call_default_factory=True)))
