"""Models that come and go while a replica is on the network.

A client learns of them when it next hears from the replica, so here each question has a new one.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from anchorflow_client import ModelId, UnknownModel
from anchorflow_client.zenoh_client import ZenohAnchorClient
from anchorflow_service.planning import PlanningService
from anchorflow_service.zenoh_endpoint import ZenohEndpoint

Ask = Callable[[str], ModelId]


def named(engine: Any, name: str, version: str = "1.2.3") -> Any:
    """Another engine of the same kind."""
    return type(engine)(replace(engine.card, name=name, version=version))


@pytest.fixture
def ask(replica: ZenohEndpoint, endpoint: str, fields: dict[str, Any]) -> Ask:
    """The model that answers a client who has only just come."""
    assert replica.replica == "a"

    def plan(model: str) -> ModelId:
        with ZenohAnchorClient(endpoint, timeout_s=20) as client:
            return client.plan(**fields, model=model).model

    return plan


def test_a_model_that_comes_is_answered(ask: Ask, planning: PlanningService, engine: Any) -> None:
    with pytest.raises(UnknownModel):
        ask("arcs")
    planning.engines.put(named(engine, "arcs"))
    assert ask("arcs").name == "arcs"


def test_a_model_that_is_swapped_answers_with_its_new_version(
    ask: Ask, planning: PlanningService, engine: Any
) -> None:
    assert ask("lines").version == "1.2.3"
    planning.engines.put(named(engine, "lines", "2.0"))
    assert ask("lines").version == "2.0"


def test_a_model_that_goes_is_asked_in_vain_and_may_come_back(
    ask: Ask, planning: PlanningService, engine: Any
) -> None:
    planning.engines.remove("bows")
    with pytest.raises(UnknownModel):
        ask("bows")
    assert ask("lines").name == "lines"
    planning.engines.put(named(engine, "bows"))
    assert ask("bows").name == "bows"


def test_a_model_whose_name_is_no_key_is_served_over_http_alone(
    ask: Ask, planning: PlanningService, engine: Any, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        planning.engines.put(named(engine, "bows and lines"))

    assert "bows and lines is served over HTTP alone" in caplog.text
    assert ask("lines").name == "lines"
