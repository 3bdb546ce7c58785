"""The fields of a JSON schema by their paths, with shape, range, unit and default."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from anchorflow_docs.field_table import Field
from anchorflow_docs.markdown import code

Schema = Mapping[str, Any]

SHAPE = re.compile(r"^\[[^\]]+\](?:(?:, | or )\[[^\]]+\])*")
"""Begins a description of an array: "[6] or [B,6]: p [m] …"."""
SHAPES = re.compile(r"\[[^\]]+\]")
UNIT_OF_ARRAY = re.compile(r"^ (m(?:/s(?:\^2)?)?)\b")
"""Follows its shape: "[N,T,D] m/s."."""
UNIT = re.compile(r" \[([^\]]+)\](?=\.$)")
"""Ends a description of a number: "Size of a cell [m/cell]."."""
LARGEST_SEED = 2**63 - 1


def schema_fields(model: type[BaseModel]) -> list[Field]:
    """The fields of a model, and of those inside it."""
    schema = model.model_json_schema()
    return list(_fields(schema, schema.get("$defs", {}), ""))


def _fields(schema: Schema, definitions: Schema, prefix: str) -> Iterator[Field]:
    for name, field in schema.get("properties", {}).items():
        choices = _choices(field, definitions)
        said = _said(_own_words(choices) or field.get("description", ""))
        yield Field(
            path=prefix + name,
            kind=SHAPES.sub(r"`\g<0>`", said.shape) or _kind(choices),
            allowed=f"{_interval(choices)} {said.unit}".strip(),
            value=_default(field, is_required=name in schema.get("required", ())),
            meaning=said.rest,
        )
        for choice in choices:
            yield from _fields(choice, definitions, f"{prefix}{name}.")


@dataclass(frozen=True)
class _Said:
    """A description, taken apart."""

    shape: str
    unit: str
    rest: str


def _said(description: str) -> _Said:
    rest, shape, unit = description, "", ""
    if found := SHAPE.match(rest):
        shape, rest = found[0], rest[found.end() :]
        if found := UNIT_OF_ARRAY.match(rest):
            unit, rest = found[1], rest[found.end() :]
    elif found := UNIT.search(rest):
        unit, rest = found[1], rest[: found.start()] + "."
    rest = rest.lstrip(" ,;:.").replace("^2", "²")
    is_word = rest[:2].isalpha()  # and no letter that stands for a quantity or a unit
    return _Said(shape, unit.replace("^2", "²"), rest[:1].upper() + rest[1:] if is_word else rest)


def _choices(field: Schema, definitions: Schema) -> list[Schema]:
    """What may stand in a field, references followed; null, which leaves it out, is none."""
    choices = [
        definitions[choice["$ref"].rpartition("/")[2]] if "$ref" in choice else choice
        for choice in field.get("anyOf", [field])
    ]
    return [choice for choice in choices if choice.get("type") != "null"]


def _own_words(choices: list[Schema]) -> str:
    """The first line of what an object says of itself; of the first, where there is a choice."""
    return choices[0].get("description", "").partition("\n")[0]


def _kind(choices: list[Schema]) -> str:
    return " or ".join(dict.fromkeys(map(_kind_of, choices)))


def _kind_of(choice: Schema) -> str:
    match choice:
        case {"const": value}:
            return code(json.dumps(value))
        case {"enum": [*values]}:
            return ", ".join(code(json.dumps(value)) for value in values)
        case {"type": "array", "items": items}:
            return f"list of {_kind_of(items)}s"
        case {"type": "object"} if "uniform" in choice.get("properties", {}):
            return code('{"uniform": n}')
        case {"type": kind}:
            return str(kind)
        case _:
            raise ValueError(f"expected a type, a constant or an enumeration, got {choice}")


def _interval(choices: list[Schema]) -> str:
    """The bounds of the choice that has some."""
    for choice in choices:
        low = choice.get("minimum", choice.get("exclusiveMinimum"))
        high = choice.get("maximum", choice.get("exclusiveMaximum"))
        if low is not None and high is not None:
            left = "[" if "minimum" in choice else "("
            right = "]" if "maximum" in choice else ")"
            return f"{left}{low:g}, {_figure(high)}{right}"
    return ""


def _figure(value: float) -> str:
    return "2⁶³ − 1" if value == LARGEST_SEED else f"{value:g}"


def _default(field: Schema, *, is_required: bool) -> str:
    if is_required:
        return "required"
    value = field.get("default")
    return "" if value is None else code(json.dumps(value))
