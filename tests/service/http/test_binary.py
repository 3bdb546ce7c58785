"""`POST /anchors` in binary, by the real client and by hand."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from anchorflow_client import (
    AnchorClient,
    AnchorRequest,
    CostMap,
    InvalidRequest,
    OipCodec,
    Payload,
)

CODEC = OipCodec()
LENGTH = "Inference-Header-Content-Length"


@pytest.fixture
def client(service: Any) -> AnchorClient:
    return AnchorClient("http://test", transport=service, codec=CODEC)


def post(service: Any, payload: Payload, length: str | None = None) -> Any:
    length = str(payload.header_length) if length is None else length
    headers = {"Content-Type": "application/octet-stream"} | ({LENGTH: length} if length else {})
    return service.request("POST", "/anchors", headers=headers, content=payload.body)


def test_an_answer_says_where_its_tensors_begin(service: Any, fields: dict[str, Any]) -> None:
    payload = CODEC.encode_request(AnchorRequest.from_fields(fields | {"request_id": "b1"}))

    answer = post(service, payload)

    assert answer.headers["content-type"] == "application/octet-stream"
    assert answer.headers["x-request-id"] == "b1"
    header = json.loads(answer.content[: int(answer.headers[LENGTH])])
    assert (header["model_name"], header["id"]) == ("lines", "b1")


@pytest.mark.parametrize("length", ["abc", "-64", "6.4", "9" * 5000, " "])
def test_a_length_that_is_no_number_is_refused(
    service: Any, fields: dict[str, Any], length: str
) -> None:
    payload = CODEC.encode_request(AnchorRequest.from_fields(fields))

    error = post(service, payload, length).json()["error"]

    assert (error["code"], error["field"]) == ("invalid_request", LENGTH)


def test_a_body_without_its_length_is_refused(service: Any, fields: dict[str, Any]) -> None:
    payload = CODEC.encode_request(AnchorRequest.from_fields(fields))

    answer = post(service, payload, "")

    assert answer.status_code == 422
    assert answer.json()["error"]["field"] == "header_length"
    assert LENGTH in answer.json()["error"]["message"]


def test_a_refusal_is_json_and_names_the_field(
    client: AnchorClient, service: Any, fields: dict[str, Any]
) -> None:
    payload = CODEC.encode_request(AnchorRequest.from_fields(fields))
    cut = Payload(payload.body[:-8], payload.header_length)  # the map is what comes last

    answer = post(service, cut)

    assert answer.headers["content-type"] == "application/json"
    assert answer.json()["error"]["field"] == "cost_map"
    with pytest.raises(InvalidRequest, match="v_max"):
        client.plan(**fields, v_max=9.0)


def test_a_map_of_the_largest_size_fits(client: AnchorClient, fields: dict[str, Any]) -> None:
    fields["cost_map"] = CostMap.build(np.zeros((8, 512, 512)), 0.1)

    assert client.plan(**fields).trajectories.shape == (4, 16, 2)


def test_the_documentation_knows_the_form(service: Any) -> None:
    operation = service.request("GET", "/openapi.json").json()["paths"]["/anchors"]["post"]

    assert operation["parameters"][0]["name"] == LENGTH
    answered = operation["responses"]["200"]
    assert LENGTH in answered["headers"]
    for content in (operation["requestBody"]["content"], answered["content"]):
        assert set(content) == {"application/json", "application/octet-stream"}
        assert content["application/octet-stream"]["schema"]["format"] == "binary"
    assert answered["content"]["application/json"]["schema"]["$ref"].endswith("/AnchorAnswerBody")
