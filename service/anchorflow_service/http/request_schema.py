"""The JSON Schema of a request, made from the contract's table; a part of /openapi.json.

Each property has its `description`, its range and its default. `x-unit` and `x-shape` hold the
unit and the axes of a field that has them, for whoever builds a form from the schema. Requests are
not checked against it: the contract checks them itself, in the same words on every transport.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from anchorflow_client.contract.checks import DTYPES, MAX_AXES, MAX_TEXT_LENGTH, Interval
from anchorflow_client.contract.fields import MAX_SCENES, REQUEST
from anchorflow_client.contract.rows import (
    MAX_SCHEDULE_STEPS,
    Array,
    Flag,
    Group,
    Inputs,
    Names,
    Number,
    Row,
    Text,
)

Schema = dict[str, Any]

EXAMPLE = {
    "cost_map": {"data": [[[0.0] * 16] * 16], "resolution": 0.5},
    "x_curr": [-3.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    "x_goal": [3.0, 1.0, 0.0, 0.0],
    "num_samples": 4,
}
"""A free map of 8 m around (0, 0), crossed from left to right."""
TEXT = {"type": "string", "minLength": 1, "maxLength": MAX_TEXT_LENGTH, "pattern": r"^[ -~]*$"}
BASE64 = {"type": "string", "contentEncoding": "base64"}


def _object(properties: Schema, *, required: Sequence[str] = ()) -> Schema:
    needed = {"required": [*required]} if required else {}
    return {
        "type": "object",
        "properties": properties,
        "additionalProperties": False,
        **needed,
    }


BYTES = _object(
    {
        "dtype": {"type": "string", "enum": [*DTYPES]},
        "shape": {
            "type": "array",
            "items": {"type": "integer", "minimum": 1},
            "maxItems": MAX_AXES,
        },
        "base64": BASE64,
    },
    required=("dtype", "shape", "base64"),
) | {"description": "A tensor as little-endian bytes in row-major order."}
FORMS: dict[str, Schema] = {
    key: _object({key: value}, required=(key,))
    for key, value in {
        "png": BASE64,
        "jpeg": BASE64,
        "uniform": {"type": "integer", "minimum": 1, "maximum": MAX_SCHEDULE_STEPS},
    }.items()
}
"""Objects with one key that may stand for an array."""
INPUT: list[Schema] = [
    BYTES,
    FORMS["png"],
    FORMS["jpeg"],
    {"type": "string"},
    {"type": "number"},
    {"type": "array", "items": {}},
]
"""An array, a picture, a text or nested lists of numbers; a list of strings is a batch."""


def request_schema() -> Schema:
    """Return the schema of the body of `POST /anchors`."""
    return {
        "title": "AnchorRequestBody",
        "description": "A map, a state and a goal in the map's frame, or the inputs that the "
        "model's card lists; everything else has a default. SI units.\n\nA leading B on "
        "cost_map.data, x_curr, x_goal or w_style makes it a batch of scenes; a field without it "
        "is shared by all of them.",
        **_object({name: schema_of(row) for name, row in REQUEST.fields.items()}),
        "examples": [EXAMPLE],
    }


def schema_of(row: Row) -> Schema:
    """Return the schema of one field; null leaves out a field that is not required."""
    facts: Schema = {"description": row.meaning}
    if row.default is not None:
        facts["default"] = row.default
    match row:
        case Array(shape=shape, unit=unit):
            facts |= {"x-shape": shape} | ({"x-unit": unit} if unit else {})
        case Number(interval=Interval(unit=unit)) if unit:
            facts["x-unit"] = unit
    forms = _forms(row)
    if not row.required:
        forms.append({"type": "null"})
    return facts | (forms[0] if len(forms) == 1 else {"anyOf": forms})


def _forms(row: Row) -> list[Schema]:
    """Return the schemas of the values that a field may have."""
    match row:
        case Array():
            return _array_forms(row)
        case Group(fields=fields):
            inside = {name: schema_of(each) for name, each in fields.items()}
            return [_object(inside, required=row.required_fields)]
        case Number(interval=interval, whole=whole):
            return [{"type": "integer" if whole else "number", **_bounds(interval)}]
        case Flag():
            return [{"type": "boolean"}]
        case Text(options=options):
            return [{"type": "string", "enum": [*options]} if options else TEXT]
        case Names():
            return [{"type": "array", "items": TEXT}]
        case Inputs():
            values = {"additionalProperties": {"anyOf": INPUT}}
            return [{"type": "object", "propertyNames": TEXT, **values}]
    raise TypeError(f"no schema for a {type(row).__name__}")


def _array_forms(row: Array) -> list[Schema]:
    nested: Schema = {"type": "number", **_bounds(row.interval)}
    for least, most in reversed(row.sizes):
        nested = {"type": "array", "items": nested, "minItems": least, "maxItems": most}
    forms = [nested]
    if row.batched:
        forms.append({"type": "array", "items": nested, "minItems": 1, "maxItems": MAX_SCENES})
    forms += [{"const": word} for word in row.words]
    return [*forms, *(FORMS[key] for key in row.objects), BYTES]


def _bounds(interval: Interval) -> Schema:
    low = "exclusiveMinimum" if interval.open_low else "minimum"
    high = "exclusiveMaximum" if interval.open_high else "maximum"
    return {low: interval.low, high: interval.high}
