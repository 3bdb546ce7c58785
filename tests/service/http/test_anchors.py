"""`POST /anchors` with good requests, by the real client and by hand."""

from __future__ import annotations

import json
import threading
from typing import Any

import numpy as np
import pytest

from anchorflow_client import (
    AnchorBatch,
    AnchorClient,
    DeadlineExceeded,
    InvalidRequest,
)
from anchorflow_service.http.schemas import AnchorAnswerBody, ModelsBody


@pytest.fixture
def client(service: Any) -> AnchorClient:
    return AnchorClient("http://test", transport=service)


@pytest.mark.parametrize("num_scenes", [1, 3])
def test_a_batch_has_one_and_each_scene_is_planned_as_if_alone(
    client: AnchorClient, fields: dict[str, Any], num_scenes: int
) -> None:
    goals = [[3.0, 0.5 + 0.25 * b, 0.0, 0.0] for b in range(num_scenes)]

    fields["x_goal"] = goals
    together = client.plan(**fields)

    assert together.trajectories.shape == (num_scenes, 4, 16, 2)
    assert together.safe.shape == (num_scenes, 4)
    for b, goal in enumerate(goals):
        fields["x_goal"] = goal
        alone = client.plan(**fields)
        assert alone.scores.shape == (4,)
        np.testing.assert_array_equal(together.trajectories[b], alone.trajectories)


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


@pytest.mark.parametrize("budget_ms", [1e-6, 20.0])
def test_a_spent_budget_is_a_deadline_exceeded(
    client: AnchorClient, engine: Any, fields: dict[str, Any], budget_ms: float
) -> None:
    def late(batch: AnchorBatch) -> AnchorBatch:
        threading.Event().wait(0.03)
        return batch

    engine.before_answer = late

    with pytest.raises(DeadlineExceeded, match=f"within {budget_ms:g} ms") as caught:
        client.plan(**fields, budget_ms=budget_ms)
    assert (caught.value.field, caught.value.http_status) == ("budget_ms", 504)
    assert client.plan(**fields, budget_ms=60_000).seed == 1


def test_an_engines_refusal_is_the_callers(
    client: AnchorClient, engine: Any, fields: dict[str, Any]
) -> None:
    def refuse(_: AnchorBatch) -> AnchorBatch:
        raise InvalidRequest("not supported by this version", "warm_start")

    engine.before_answer = refuse

    with pytest.raises(InvalidRequest, match="warm_start: not supported"):
        client.plan(**fields)


def test_the_documentation_is_true(service: Any, fields: dict[str, Any]) -> None:
    """Answers keep the schemas of /openapi.json, taken strictly."""
    batched = fields | {"x_goal": [fields["x_goal"]]}

    for request in (fields, batched):
        AnchorAnswerBody.model_validate_json(service.post(request).content, strict=True)
    ModelsBody.model_validate_json(service.request("GET", "/v2/models").content, strict=True)
