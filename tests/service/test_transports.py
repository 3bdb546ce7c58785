"""One service, two transports: the same bytes, from the same queue, in one process."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from served import in_process, opened, sent_over_http, sent_over_zenoh

from anchorflow_client import (
    AnchorBatch,
    AnchorRequest,
    InternalError,
    OipCodec,
    Payload,
    UnknownModel,
)
from anchorflow_client.zenoh_client import ZenohAnchorClient, ZenohSettings
from anchorflow_client.zenoh_client.session import open_session
from anchorflow_service.http import create_app
from anchorflow_service.local import LocalClient
from anchorflow_service.planning import PlanningService
from anchorflow_service.repository import BundleFolders, Repository
from anchorflow_service.zenoh_endpoint import ZenohEndpoint

CODEC = OipCodec()


def both(planning: PlanningService, endpoint: str, sent: Payload) -> list[Payload]:
    """The answers of one application over HTTP and over zenoh."""
    zenoh = ZenohEndpoint(planning, open_session(ZenohSettings(listen=(endpoint,))), replica="a")
    with in_process(create_app(planning, endpoints=[zenoh])) as app:
        return [sent_over_http(app, CODEC, sent), sent_over_zenoh(endpoint, "lines", sent)]


@pytest.mark.parametrize("kind", ["engine", "free_engine"])
def test_the_answers_are_the_same_bytes(
    request: pytest.FixtureRequest, kind: str, endpoint: str, fields: dict[str, Any]
) -> None:
    """All but the time that each took, which stands still here."""
    engines = {"lines": request.getfixturevalue(kind)}
    planning = PlanningService(engines, default="lines", clock=lambda: 7.0)
    sent = CODEC.encode_request(AnchorRequest.from_fields(fields | {"request_id": "r1"}))

    by_http, by_zenoh = both(planning, endpoint, sent)

    assert by_http == by_zenoh
    assert by_http.header_length
    batch = CODEC.decode_answer(by_zenoh)
    assert batch.request_id == "r1"
    own = [1.0, 1.1, 1.2, 1.3] if kind == "free_engine" else [8.0] * 4
    assert batch.durations == pytest.approx(own)


@pytest.mark.parametrize(
    ("wrong", "field"),
    [({"v_max": 9.0}, "v_max"), ({"x_curr": [0.0] * 9, "x_goal": [0.0] * 6}, "x_curr")],
)
def test_the_refusals_are_the_same_bytes(
    planning: PlanningService,
    endpoint: str,
    fields: dict[str, Any],
    wrong: dict[str, Any],
    field: str,
) -> None:
    sent = CODEC.encode_request(AnchorRequest.from_fields(fields | wrong))

    by_http, by_zenoh = both(planning, endpoint, sent)

    assert by_http == by_zenoh
    error = json.loads(by_http.body)["error"]
    assert (error["code"], error["field"]) == ("invalid_request", field)


def test_what_is_loaded_over_http_is_served_over_zenoh(
    tiny_bundle: Path,
    edit_manifest: Callable[..., None],
    endpoint: str,
    small_request: Callable[..., AnchorRequest],
) -> None:
    """And what is unloaded there is served no longer, nor by the client's older knowledge."""

    planning = PlanningService({"tiny": opened(tiny_bundle)}, default="tiny")
    repository = Repository(planning.engines, BundleFolders([tiny_bundle]), opened)
    session = open_session(ZenohSettings(listen=(endpoint,)))
    app = create_app(planning, endpoints=[ZenohEndpoint(planning, session)], repository=repository)
    # Rename the model of the bundle in the folder.
    edit_manifest("name", to="newer")

    def ask(zenoh: ZenohAnchorClient, name: str) -> str:
        return zenoh.plan_request(small_request(model=name)).model.name

    with in_process(app) as http, ZenohAnchorClient(endpoint, timeout_s=20) as zenoh:

        def change(what: str) -> None:
            assert http.post(b"", f"/v2/repository/models/{what}").status_code == 200

        assert ask(zenoh, "tiny") == "tiny"
        with pytest.raises(UnknownModel):
            ask(zenoh, "newer")
        change("newer/load")
        assert [ask(zenoh, "newer"), ask(zenoh, "tiny")] == ["newer", "tiny"]
        change("tiny/unload")
        assert http.request("GET", "/v2/models/tiny/ready").status_code == 404
        with pytest.raises(UnknownModel, match=r"\(newer\), got 'tiny'"):
            ask(zenoh, "tiny")
        assert ask(zenoh, "newer") == "newer"


def test_with_a_running_clock_only_the_times_differ(
    planning: PlanningService, endpoint: str, fields: dict[str, Any]
) -> None:
    sent = CODEC.encode_request(AnchorRequest.from_fields(fields | {"request_id": "r1"}))

    headers, tensors = [], []
    for payload in both(planning, endpoint, sent):
        length = payload.header_length or 0
        header = json.loads(payload.body[:length])
        for stage in ("queue", "total"):
            assert header["parameters"].pop(f"timing_ms.{stage}") > 0
        headers.append(header)
        tensors.append(payload.body[length:])

    assert headers[0] == headers[1]
    assert tensors[0] == tensors[1]


def test_the_local_client_refuses_an_answer_that_is_not_finite_too(
    engine: Any, fields: dict[str, Any]
) -> None:
    def broken(batch: AnchorBatch) -> AnchorBatch:
        far = np.full_like(batch.trajectories, np.inf)
        return replace(batch, arrays={**batch.arrays, "trajectories": far})

    client = LocalClient(engine)
    assert client.plan(**fields).is_finite
    engine.before_answer = broken
    with pytest.raises(InternalError, match="numbers that are not finite"):
        client.plan(**fields)
