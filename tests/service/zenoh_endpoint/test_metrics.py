"""Queries are counted beside HTTP's requests, through the service that both share."""

from __future__ import annotations

from typing import Any

import pytest

from anchorflow_client import InvalidRequest
from anchorflow_client.zenoh_client import ZenohAnchorClient
from anchorflow_service.observability.metrics import Metrics
from anchorflow_service.planning import PlanningService


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
