"""`plan` spells out the contract's fields, so that an editor can complete them."""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np
import pytest

from anchorflow_client import AsyncAnchorClient, BaseAsyncClient, BaseClient, Planner
from anchorflow_client.contract.request import FIELDS

PLACE = {"resolution", "origin"}
"""Of a map that is given as an array."""
SET_BY_THE_PLANNER = {"request_id"}


def keywords_of(function: Any) -> dict[str, inspect.Parameter]:
    _, *parameters = inspect.signature(function).parameters.values()
    return {parameter.name: parameter for parameter in parameters}


@pytest.mark.parametrize("kind", [BaseClient, BaseAsyncClient])
def test_plan_has_every_field_as_a_keyword(kind: type[BaseClient | BaseAsyncClient]) -> None:
    keywords = keywords_of(kind.plan)

    assert set(keywords) == set(FIELDS) | PLACE
    assert {each.kind for each in keywords.values()} == {inspect.Parameter.KEYWORD_ONLY}


def test_update_has_what_a_planner_does_not_set_itself() -> None:
    assert set(keywords_of(Planner.update)) == set(FIELDS) | PLACE - SET_BY_THE_PLANNER


@pytest.mark.parametrize("function", [BaseClient.plan, Planner.update])
def test_every_keyword_is_told_of(function: Any) -> None:
    told = inspect.getdoc(function) or ""

    missing = [name for name in keywords_of(function) if f"    {name}: " not in told]
    assert missing == []


async def never_sent(*_: object, **__: object) -> Any:
    raise AssertionError("sent")


def test_an_async_refusal_comes_where_the_answer_is_awaited(fields: dict[str, Any]) -> None:
    """Or of two that are gathered, one would be made and never awaited."""
    client = AsyncAnchorClient("http://robot")
    client.plan_request = never_sent  # pyright: ignore[reportAttributeAccessIssue]
    fields["cost_map"] = np.zeros((16, 20))

    refused = client.plan(**fields | {"x_goal": [0, 0]}, resolution=0.5)

    with pytest.raises(Exception, match="x_goal"):
        refused.send(None)
