"""The page at `/docs`: every endpoint with its fields and an example, made from OpenAPI.

It loads nothing but a style sheet of this package.
"""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Iterator, Mapping
from html import escape
from typing import Any

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from anchorflow_service.http.openapi import EXAMPLE
from anchorflow_service.http.page import HEADERS

METHODS = ("get", "post")
HOST = re.compile(r"[\w.:\[\]-]{1,200}")
"""Hosts that examples name; others are none."""
SIDE = 16
MOST_CHARACTERS = 2000
"""Of an example."""
PLAN_EXAMPLE = {
    **EXAMPLE,
    "cost_map": {
        "data": {
            "dtype": "uint8",
            "shape": [1, SIDE, SIDE],
            "base64": base64.b64encode(bytes(SIDE * SIDE)).decode(),
        },
        "resolution": EXAMPLE["cost_map"]["resolution"],
    },
}
PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{title}: the API</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="/page/icon.svg"><link rel="stylesheet" href="/page/api.css"></head>
<body><header><h1>{title} {version}</h1><p>{summary}</p>
<p><a href="/">The page</a> · <a href="/openapi.json">openapi.json</a></p></header>
<main>{endpoints}</main></body></html>
"""


def api_router() -> APIRouter:
    router = APIRouter(include_in_schema=False)

    @router.get("/docs")
    async def docs(request: Request) -> Response:
        """Every endpoint with an example."""
        host = request.headers.get("host", "")
        address = host if HOST.fullmatch(host) else "127.0.0.1:8000"
        body = page(request.app.openapi(), f"{request.url.scheme}://{address}")
        return Response(body, headers=HEADERS, media_type="text/html; charset=utf-8")

    return router


def page(document: Mapping[str, Any], url: str) -> str:
    """Return the page of an OpenAPI document; url: of the service, in the examples."""
    about, schemas = document["info"], document["components"]["schemas"]
    endpoints = "".join(
        _endpoint(path, method, item[method], schemas, url)
        for path, item in document["paths"].items()
        for method in METHODS
        if method in item
    )
    words = {name: escape(about.get(name, "")) for name in ("title", "version", "summary")}
    return PAGE.format(endpoints=endpoints, **words)


def _endpoint(
    path: str, method: str, told: Mapping[str, Any], schemas: Mapping[str, Any], url: str
) -> str:
    content = told.get("requestBody", {}).get("content", {}).get("application/json", {})
    name = content.get("schema", {}).get("$ref", "").rpartition("/")[2]
    schema = schemas.get(name, {})
    rows = "".join(
        f"<tr><td><code>{escape(field)}</code></td><td>{escape(kind)}</td><td>{escape(text)}</td></tr>"
        for field, kind, text in _fields(schema)
    )
    table = f"<table><tr><th>field<th>shape, unit, default<th>meaning</tr>{rows}</table>"
    answers = ", ".join(
        f"{code} {each.get('description', '')}" for code, each in told["responses"].items()
    )
    return (
        f'<section><h2><span class="method">{method.upper()}</span> {escape(path)}</h2>'
        f"<p>{escape(told.get('description', ''))}</p>"
        f"<pre>{escape(_curl(path, method, schema, url))}</pre>"
        f"{table if rows else ''}<p class='answers'>Answers: {escape(answers)}</p></section>"
    )


def _fields(schema: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str, str]]:
    """Yield path, kind and meaning of the fields of an object, and of objects in it."""
    required = schema.get("required", ())
    for name, each in schema.get("properties", {}).items():
        kind = [str(each[key]) for key in ("x-shape", "x-unit") if key in each]
        if name in required:
            kind.append("required")
        elif "default" in each:
            kind.append(f"default {json.dumps(each['default'])}")
        yield prefix + name, ", ".join(kind), each.get("description", "")
        for form in (each, *each.get("anyOf", ())):
            if form.get("properties") and "base64" not in form["properties"]:
                yield from _fields(form, f"{prefix}{name}.")


def _curl(path: str, method: str, schema: Mapping[str, Any], url: str) -> str:
    if method == "get":
        return f"curl -s {url}{path}"
    example = PLAN_EXAMPLE if path == "/anchors" else next(iter(schema.get("examples", ())), {})
    body = json.dumps(example)
    if len(body) > MOST_CHARACTERS:
        body = json.dumps(dict.fromkeys(example, "…"))
    return f"curl -s {url}{path} -H 'Content-Type: application/json' -d '{body}'"
