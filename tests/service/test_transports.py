"""Beside HTTP: zenoh serves what is loaded over HTTP, and the local client checks its answers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from served import in_process, opened

from anchorflow_client import (
    AnchorBatch,
    AnchorRequest,
    InternalError,
    OipCodec,
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
