"""A request meets a card."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from anchorflow_client import AnchorRequest, InvalidRequest, ModelCard, OdeSpec, RefineSpec
from anchorflow_client.contract import (
    EIGHT_STEP_SCHEDULE,
    LimitsSpec,
    ResolvedRequest,
    resolve_for_card,
)


def of_dim(card: ModelCard, dim: int) -> ModelCard:
    components = ("x", "y", "heading")[:dim]
    return replace(card, answer=replace(card.answer, components=components))


def limits_of(request: ResolvedRequest) -> LimitsSpec:
    assert request.limits is not None
    return request.limits


def test_what_is_left_open_is_the_cards(fields: dict[str, Any], card: ModelCard) -> None:
    resolved = resolve_for_card(AnchorRequest.from_fields(fields), card)

    assert (
        limits_of(resolved).robot_radius,
        limits_of(resolved).v_max,
        limits_of(resolved).a_max,
    ) == (0.25, 2.0, 3.0)
    assert (limits_of(resolved).horizon_s, resolved.model) == (8.0, "lines")
    assert (resolved.sampler, resolved.refine) == (card.sampler, card.finish)
    assert 0 <= resolved.seed < 2**53


def test_a_partial_choice_keeps_the_rest_of_the_cards(
    fields: dict[str, Any], card: ModelCard
) -> None:
    fields |= {"sampler": {"schedule": "8step"}, "refine": {"smooth": False}}

    resolved = resolve_for_card(AnchorRequest.from_fields(fields), card)

    assert resolved.sampler == OdeSpec("rk4", EIGHT_STEP_SCHEDULE)
    assert resolved.refine == RefineSpec(False, True, 0.05, 0.0)


def test_uniform_steps_become_times(fields: dict[str, Any], card: ModelCard) -> None:
    fields["sampler"] = {"method": "euler", "schedule": {"uniform": 4}}

    resolved = resolve_for_card(AnchorRequest.from_fields(fields), card)

    assert resolved.sampler == OdeSpec("euler", (0.0, 0.25, 0.5, 0.75, 1.0))


def test_resolving_twice_changes_nothing(fields: dict[str, Any], card: ModelCard) -> None:
    once = resolve_for_card(AnchorRequest.from_fields(fields), card)

    assert resolve_for_card(once, card).field_values() == once.field_values()


def test_an_adjustable_limit_is_the_requests(fields: dict[str, Any], card: ModelCard) -> None:
    resolved = resolve_for_card(AnchorRequest.from_fields(fields | {"robot_radius": 0.4}), card)

    assert limits_of(resolved).robot_radius == 0.4


@pytest.mark.parametrize(("field", "value"), [("v_max", 3.0), ("a_max", 1.0), ("horizon_s", 4)])
def test_a_fixed_limit_is_refused_by_name(
    fields: dict[str, Any], card: ModelCard, field: str, value: float
) -> None:
    with pytest.raises(
        InvalidRequest, match=f"{field}: expected .*lines 1.2.3.*got {value:g}"
    ) as e:
        resolve_for_card(AnchorRequest.from_fields(fields | {field: value}), card)
    assert e.value.field == field


PLANAR = {"x_curr": [-3.0, 0.5, *[0.0] * 4], "x_goal": [3.0, 0.5, *[0.0] * 2]}
TURNING = {"x_curr": [-3.0, 0.5, *[0.0] * 7], "x_goal": [3.0, 0.5, *[0.0] * 4]}


@pytest.mark.parametrize(
    ("dim", "states", "words"),
    [
        (2, TURNING, r"\[6\] or \[B,6\], as lines 1.2.3 has D = 2, got \[9\]"),
        (3, PLANAR, r"\[9\] or \[B,9\], as lines 1.2.3 has D = 3, got \[6\]"),
        (3, {**PLANAR, "x_curr": [PLANAR["x_curr"]] * 5}, r"\[9\] or \[B,9\], .* got \[5,6\]"),
    ],
)
def test_another_number_of_dimensions_is_refused(
    fields: dict[str, Any], card: ModelCard, dim: int, states: dict[str, Any], words: str
) -> None:
    request = AnchorRequest.from_fields(fields | states)

    with pytest.raises(InvalidRequest, match=words) as caught:
        resolve_for_card(request, of_dim(card, dim))
    assert caught.value.field == "x_curr"


def test_a_heading_meets_a_card_that_has_one(fields: dict[str, Any], card: ModelCard) -> None:
    request = AnchorRequest.from_fields(fields | TURNING)

    assert resolve_for_card(request, of_dim(card, 3)).on_map.dim == 3


def test_a_limit_that_went_through_float32_is_the_same(
    fields: dict[str, Any], card: ModelCard
) -> None:
    resolved = resolve_for_card(AnchorRequest.from_fields(fields | {"v_max": 2.0 + 1e-7}), card)

    assert limits_of(resolved).v_max == 2.0
