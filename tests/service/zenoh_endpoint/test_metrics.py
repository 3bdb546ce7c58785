"""Queries are counted beside HTTP's requests, by the service that both share."""

from __future__ import annotations

from typing import Any

import pytest

from anchorflow_client import InvalidRequest
from anchorflow_client.zenoh_client import ZenohAnchorClient, ZenohSettings
from anchorflow_client.zenoh_client.session import open_session
from anchorflow_client.zenoh_messages import replica_anchors_key
from anchorflow_service.observability.metrics import Metrics
from anchorflow_service.planning import PlanningService
from anchorflow_service.zenoh_endpoint import ZenohEndpoint


def test_a_query_is_counted_under_its_transport(
    planning: PlanningService, client: ZenohAnchorClient, fields: dict[str, Any]
) -> None:
    metrics = Metrics(planning)

    client.plan(**fields)
    with pytest.raises(InvalidRequest):
        client.plan(**fields, horizon_s=5.0)

    text = metrics.render().decode()
    for outcome in ("ok", "invalid_request"):
        labels = f'model="lines",outcome="{outcome}",transport="zenoh"'
        assert f"anchorflow_requests_total{{{labels}}} 1.0" in text
    assert 'anchorflow_request_seconds_count{transport="zenoh"} 1.0' in text


def test_a_request_that_is_refused_before_it_is_read_is_counted(
    planning: PlanningService, replica: ZenohEndpoint, endpoint: str
) -> None:
    metrics = Metrics(planning)
    too_large = bytes(planning.limits.max_body_bytes + 1)

    with open_session(ZenohSettings(mode="client", connect=(endpoint,))) as session:
        for body, attachment in ((too_large, b'{"header_length": 9}'), (b"", b"no JSON")):
            key = replica_anchors_key(replica.replica, "lines")
            (answer,) = session.get(key, payload=body, attachment=attachment)
            assert answer.err is not None

    text = metrics.render().decode()
    for outcome in ("too_large", "invalid_request"):
        labels = f'model="",outcome="{outcome}",transport="zenoh"'
        assert f"anchorflow_requests_total{{{labels}}} 1.0" in text
