"""The OpenAPI document: routes whose bodies are parsed by hand, and the schema of a request.

The schema of `POST /anchors` is made from the contract's table. Each property has a description, a
range and a default; `x-unit` and `x-shape` are its unit and axes, for programs that build a form.
Requests are not validated against it: the contract checks them in the same words on every
transport.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic import BaseModel

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
from anchorflow_client.errors import (
    DeadlineExceeded,
    InternalError,
    InvalidRequest,
    NotReady,
    Overloaded,
    RequestError,
    Superseded,
    TooLarge,
    UnknownModel,
)
from anchorflow_client.oip_message import DATATYPES
from anchorflow_service.http.infer_codec import MAX_ENTRIES
from anchorflow_service.http.schemas import (
    AnchorAnswerBody,
    ErrorBody,
    InferAnswerBody,
    ModelMetadataBody,
    ModelReadyBody,
    ModelsBody,
    ModelStateBody,
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
FLAG = {"type": "boolean", "default": False}
SHAPE = {"type": "array", "items": {"type": "integer", "minimum": 1}, "maxItems": MAX_AXES}
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
        "shape": SHAPE,
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


# The Open Inference Protocol: arrays are tensors, other fields parameters by their JSON path.


def _nullable(schema: Schema, meaning: str = "") -> Schema:
    described = {"description": meaning} if meaning else {}
    return {"anyOf": [schema, {"type": "null"}], **described}


def _few(items: Schema) -> Schema:
    return {"type": "array", "items": items, "maxItems": MAX_ENTRIES}


def reference(name: str) -> Schema:
    return {"$ref": f"#/components/schemas/{name}"}


def _options(name: str) -> Schema:
    """Return the property `parameters`, an optional object of the schema of that name."""
    return {"parameters": _nullable(reference(name))}


def _nested(kind: str, axes: int) -> Schema:
    schema: Schema = {"type": kind}
    for _ in range(axes):
        schema = {"type": "array", "items": schema}
    return schema


NAME = TEXT | {"description": "A name in the model's metadata."}
DATA: Schema = {
    "description": "In row-major order; numbers, or for BOOL booleans, flat or nested.",
    "anyOf": [
        *(_nested("number", axes) for axes in range(1, 5)),
        _nested("boolean", 1),
        _nested("string", 1),
    ],
}
SCALARS = [{"type": kind} for kind in ("boolean", "integer", "number", "string")]
INFER_EXAMPLE = {
    "inputs": [
        {"name": "cost_map", "datatype": "FP32", "shape": [1, 16, 16], "data": [0.0] * 256},
        {"name": "map_geometry", "datatype": "FP32", "shape": [3], "data": [-4.0, -4.0, 0.5]},
        {"name": "x_curr", "datatype": "FP64", "shape": [6], "data": EXAMPLE["x_curr"]},
        {"name": "x_goal", "datatype": "FP64", "shape": [4], "data": EXAMPLE["x_goal"]},
    ],
    "parameters": {"num_samples": 4},
}
INPUTS = "map_geometry is [3] or [B,3]: origin x and y [m], resolution [m/cell]."
OTHER_REQUESTS: dict[str, Schema] = {
    "InferInputBody": _object(
        {
            "name": NAME,
            "datatype": {"type": "string", "enum": [*DATATYPES]},
            "shape": SHAPE,
            "data": DATA,
        },
        required=("name", "datatype", "shape", "data"),
    )
    | {"description": "A tensor in JSON; in the binary form its data follow the header."},
    "InferOutputBody": _object(
        {"name": NAME, **_options("OutputParametersBody")}, required=("name",)
    ),
    "OutputParametersBody": _object({"binary_data": FLAG}),
    "InferRequestBody": _object(
        {
            "id": _nullable(TEXT, "Echoed."),
            "parameters": _nullable(
                {
                    "type": "object",
                    "additionalProperties": {"anyOf": SCALARS},
                    "maxProperties": MAX_ENTRIES,
                },
                "num_samples, seed, budget_ms, robot_id, sampler.method, refine.project, …; "
                "`binary_data_output` for outputs in binary, `timeout` for a budget in "
                "microseconds.",
            ),
            "inputs": _few(reference("InferInputBody")) | {"description": INPUTS},
            "outputs": _nullable(_few(reference("InferOutputBody")), "All of them."),
        },
        required=("inputs",),
    )
    | {
        "description": "Arrays are tensors, all other fields of a request parameters by their JSON "
        "path.",
        "examples": [INFER_EXAMPLE],
    },
    "IndexRequestBody": _object({"ready": FLAG | {"description": "Only those that are served."}}),
    "LoadRequestBody": _object(_options("LoadParametersBody")),
    "LoadParametersBody": _object({"version": _nullable(TEXT, "The newest.")}),
    "UnloadRequestBody": _object(_options("UnloadParametersBody")),
    "UnloadParametersBody": _object(
        {"unload_dependents": FLAG | {"description": "No model depends on another."}}
    ),
}
"""Schemas of the other bodies, by name."""

ANCHOR_REQUEST = "AnchorRequestBody"
HEADER_LENGTH = "Inference-Header-Content-Length"
_LENGTH = {
    "description": "Bytes of the JSON header in front of the tensors; with the binary form only.",
    "schema": {"type": "integer", "minimum": 1},
}
BINARY = {
    "type": "string",
    "format": "binary",
    "description": "Open Inference Protocol v2 with the binary tensor extension: a JSON header of "
    f"{HEADER_LENGTH} bytes, then the tensors. Arrays are tensors, other fields are parameters "
    "by their JSON path.",
}


def _refusals(*errors: type[RequestError]) -> dict[int | str, dict[str, Any]]:
    return {
        error.http_status: {"model": ErrorBody, "description": f"`{error.code}`"}
        for error in errors
    }


def _content(name: str) -> dict[str, Any]:
    """Return both forms of a body: the JSON schema of that name, and the same in binary."""
    json_form = {"schema": reference(name)}
    return {"application/json": json_form, "application/octet-stream": {"schema": BINARY}}


def _planning(request: str, answer: type[BaseModel]) -> dict[str, Any]:
    """Document a route that plans, with bodies in both forms."""
    return {
        "openapi_extra": {
            "requestBody": {"required": True, "content": _content(request)},
            "parameters": [{"name": HEADER_LENGTH, "in": "header", **_LENGTH}],
        },
        "responses": {
            200: {
                "model": answer,
                "content": _content(answer.__name__),
                "headers": {HEADER_LENGTH: _LENGTH},
            }
        }
        | _refusals(
            InvalidRequest,
            UnknownModel,
            Superseded,
            TooLarge,
            Overloaded,
            DeadlineExceeded,
            NotReady,
            InternalError,
        ),
    }


def _administration(request: str, answer: Any) -> dict[str, Any]:
    """Document a route of the repository, whose body is optional."""
    content = {"application/json": {"schema": reference(request)}}
    body = {"required": False, "content": content}
    return {
        "openapi_extra": {"requestBody": body},
        "responses": {200: {"model": answer}} | _refusals(InvalidRequest, UnknownModel, TooLarge),
    }


ANCHORS_DOCUMENTATION = _planning(ANCHOR_REQUEST, AnchorAnswerBody)
INFER_DOCUMENTATION = _planning("InferRequestBody", InferAnswerBody)
METADATA_DOCUMENTATION: dict[str, Any] = {
    "responses": {200: {"model": ModelMetadataBody}} | _refusals(UnknownModel)
}
MODEL_READY_DOCUMENTATION: dict[str, Any] = {
    "responses": {200: {"model": ModelReadyBody}} | _refusals(UnknownModel, NotReady)
}
INDEX_DOCUMENTATION = _administration("IndexRequestBody", list[ModelStateBody])
LOAD_DOCUMENTATION = _administration("LoadRequestBody", ModelStateBody)
UNLOAD_DOCUMENTATION = _administration("UnloadRequestBody", ModelStateBody)
MODELS_DOCUMENTATION: dict[str, Any] = {"responses": {200: {"model": ModelsBody}}}
NOT_READY_DOCUMENTATION: dict[str, Any] = {"responses": _refusals(NotReady)}


def document(app: FastAPI) -> None:
    """Add the schemas of requests to the app's document."""

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            schema = get_openapi(
                title=app.title, version=app.version, summary=app.summary, routes=app.routes
            )
            schema["components"]["schemas"][ANCHOR_REQUEST] = request_schema()
            schema["components"]["schemas"] |= OTHER_REQUESTS
            app.openapi_schema = schema
        return app.openapi_schema

    app.openapi = openapi
