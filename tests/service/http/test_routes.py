"""Health, request ids and the documentation."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import httpx
from fastapi import FastAPI

from anchorflow_client.contract.fields import REQUEST
from anchorflow_service.http.schemas import AnchorAnswerBody, ModelsBody


def test_outside_its_lifespan_it_lives_but_is_not_ready(app: FastAPI) -> None:
    async def ask() -> list[httpx.Response]:
        transport = httpx.ASGITransport(app=app)
        async with httpx.AsyncClient(transport=transport, base_url="http://test") as client:
            return [await client.get(f"/v2/health/{kind}") for kind in ("live", "ready")]

    live, ready = asyncio.run(ask())

    assert live.status_code == 200
    assert ready.status_code == 503
    assert ready.json()["error"]["code"] == "not_ready"


def test_the_documentation_knows_every_field(service: Any) -> None:
    schema = service.request("GET", "/openapi.json").json()
    models = schema["components"]["schemas"]
    request = models["AnchorRequestBody"]

    assert set(request["properties"]) == set(REQUEST.fields)
    assert "required" not in request  # each planner requires its own inputs
    resolution = request["properties"]["cost_map"]["anyOf"][0]["properties"]["resolution"]
    assert resolution["x-unit"] == "m/cell"
    body = schema["paths"]["/anchors"]["post"]["requestBody"]["content"]["application/json"]
    assert body["schema"]["$ref"].endswith("/AnchorRequestBody")
    assert {"200", "404", "409", "413", "422", "429", "500", "503", "504"} == set(
        schema["paths"]["/anchors"]["post"]["responses"]
    )


def test_the_documentation_refers_to_nothing_that_is_missing(service: Any) -> None:
    schema = service.request("GET", "/openapi.json").json()

    def references(node: Any) -> set[str]:
        if isinstance(node, dict):
            own = {node["$ref"].rpartition("/")[2]} if "$ref" in node else set()
            return own.union(*map(references, node.values()))
        return set().union(*map(references, node)) if isinstance(node, list) else set()

    assert references(schema) <= set(schema["components"]["schemas"])


def test_the_request_id_is_echoed(service: Any, fields: dict[str, Any]) -> None:
    content = json.dumps(fields).encode()
    by_header = service.request("POST", "/anchors", headers={"X-Request-Id": "h1"}, content=content)
    by_body = service.post(fields | {"request_id": "b1"})
    drawn = service.post(fields)

    for answer, wanted in ((by_header, "h1"), (by_body, "b1")):
        assert answer.json()["request_id"] == answer.headers["x-request-id"] == wanted
    assert len(drawn.json()["request_id"]) == 32
    assert (
        service.request("GET", "/nowhere", headers={"X-Request-Id": "h2"}).headers["x-request-id"]
        == "h2"
    )


def test_answers_keep_the_documented_schemas(service: Any, fields: dict[str, Any]) -> None:
    """Taken strictly."""
    batched = fields | {"x_goal": [fields["x_goal"]]}

    for request in (fields, batched):
        AnchorAnswerBody.model_validate_json(service.post(request).content, strict=True)
    ModelsBody.model_validate_json(service.request("GET", "/v2/models").content, strict=True)
