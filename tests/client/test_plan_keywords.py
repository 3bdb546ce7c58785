"""`plan` spells out the contract's fields, so that an editor can complete them."""

from __future__ import annotations

import inspect
from typing import Any

import pytest

from anchorflow_client import (
    AsyncAnchorClient,
    BaseAsyncClient,
    BaseClient,
    InvalidRequest,
    Planner,
)
from anchorflow_client.contract.fields import REQUEST

PLACE = {"resolution", "origin", "channel_weights"}
"""The place of a map that is given as an array."""
NOT_OF_UPDATE = {"request_id", "inputs"}
"""The planner gives its requests their ids, and plans on maps alone."""


def keywords_of(function: Any) -> dict[str, inspect.Parameter]:
    _, *parameters = inspect.signature(function).parameters.values()
    return {parameter.name: parameter for parameter in parameters}


@pytest.mark.parametrize("kind", [BaseClient, BaseAsyncClient])
def test_plan_has_every_field_as_a_keyword(kind: type[BaseClient | BaseAsyncClient]) -> None:
    keywords = keywords_of(kind.plan)

    assert set(keywords) == set(REQUEST.fields) | PLACE
    assert {each.kind for each in keywords.values()} == {inspect.Parameter.KEYWORD_ONLY}


def test_update_has_the_fields_of_planning_on_a_map() -> None:
    assert set(keywords_of(Planner.update)) == (set(REQUEST.fields) | PLACE) - NOT_OF_UPDATE


def test_every_keyword_is_told_of() -> None:
    told = inspect.getdoc(BaseClient.plan) or ""

    missing = [name for name in keywords_of(BaseClient.plan) if f"    {name}: " not in told]
    assert missing == []


def test_an_async_refusal_comes_where_the_answer_is_awaited(fields: dict[str, Any]) -> None:
    """Or of two that are gathered, one would be made and never awaited."""
    client = AsyncAnchorClient("http://robot")
    fields["x_goal"] = [0, 0]

    refused = client.plan(**fields)

    with pytest.raises(InvalidRequest, match="x_goal"):
        refused.send(None)
