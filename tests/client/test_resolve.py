"""A request meets a card."""

from __future__ import annotations

from dataclasses import asdict, replace
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
    assert (resolved.cost_penalty, resolved.clear_start, resolved.goal_tolerance) == (
        3,
        False,
        None,
    )


def test_a_partial_choice_keeps_the_rest_of_the_cards(
    fields: dict[str, Any], card: ModelCard
) -> None:
    fields |= {"sampler": {"schedule": "8step"}, "refine": {"project": False}}

    resolved = resolve_for_card(AnchorRequest.from_fields(fields), card)

    assert resolved.sampler == OdeSpec("rk4", EIGHT_STEP_SCHEDULE)
    assert resolved.refine == RefineSpec(True, False, 0.05, 0.0)


@pytest.mark.parametrize("moves", ["project", "barrier"])
def test_an_unfitted_spline_cannot_be_moved(
    fields: dict[str, Any], card: ModelCard, moves: str
) -> None:
    fields["refine"] = {"smooth": False, "project": False} | {moves: True}
    with pytest.raises(InvalidRequest, match=f"expected true, or refine.{moves} false") as caught:
        resolve_for_card(AnchorRequest.from_fields(fields), card)
    assert caught.value.field == "refine.smooth"


def test_uniform_steps_become_times(fields: dict[str, Any], card: ModelCard) -> None:
    fields["sampler"] = {"method": "euler", "schedule": {"uniform": 4}}

    resolved = resolve_for_card(AnchorRequest.from_fields(fields), card)

    assert resolved.sampler == OdeSpec("euler", (0.0, 0.25, 0.5, 0.75, 1.0))


def test_resolving_twice_changes_nothing(fields: dict[str, Any], card: ModelCard) -> None:
    once = resolve_for_card(AnchorRequest.from_fields(fields), card)

    assert resolve_for_card(once, card).field_values() == once.field_values()


def test_limits_inside_their_ranges_are_the_requests(
    fields: dict[str, Any], card: ModelCard, free: ModelCard
) -> None:
    asked = {"robot_radius": 0.1, "v_max": 0.26, "a_max": 8.0, "horizon_s": 12.0}
    all_of_them = resolve_for_card(AnchorRequest.from_fields(fields | asked), free)
    one = resolve_for_card(AnchorRequest.from_fields(fields | {"robot_radius": 0.4}), card)
    none = resolve_for_card(AnchorRequest.from_fields(fields), free)

    assert asdict(limits_of(all_of_them)) == asked
    assert limits_of(one).robot_radius == 0.4
    assert limits_of(none).horizon_s is None  # each anchor has its own duration


@pytest.mark.parametrize(
    ("kind", "field", "value", "words"),
    [
        ("free", "v_max", 9.0, "expected 0.1 to 6 m/s, for which lines 1.2.3 was trained, got 9"),
        ("free", "a_max", 0.2, r"expected 0.5 to 8 m/s\^2, .* lines 1.2.3 was trained, got 0.2"),
        ("free", "robot_radius", 0.7, "expected 0.1 to 0.6 m, .* 1.2.3 was trained, got 0.7"),
        ("free", "horizon_s", 90, "expected 1 to 60 s, for which lines 1.2.3 was trained, got 90"),
        ("rigid", "horizon_s", 8, "expected none, as each anchor has its own, .* got 8"),
        ("card", "v_max", 3.0, "expected .*lines 1.2.3.*got 3"),
        ("card", "a_max", 1.0, "expected .*lines 1.2.3.*got 1"),
        ("card", "horizon_s", 4, "expected .*lines 1.2.3.*got 4"),
    ],
)
def test_a_limit_outside_its_range_or_fixed_is_refused_by_name(
    fields: dict[str, Any],
    card: ModelCard,
    free: ModelCard,
    kind: str,
    field: str,
    value: float,
    words: str,
) -> None:
    rigid = replace(free, conditioning=replace(free.cost_map, ranges={}))
    made_for = {"card": card, "free": free, "rigid": rigid}[kind]
    with pytest.raises(InvalidRequest, match=f"^{field}: {words}$") as caught:
        resolve_for_card(AnchorRequest.from_fields(fields | {field: value}), made_for)
    assert caught.value.field == field


@pytest.mark.parametrize("edge", [0.1, 6.0])
def test_the_ends_of_a_range_and_a_fixed_limit_are_met_in_float32_too(
    fields: dict[str, Any], card: ModelCard, free: ModelCard, edge: float
) -> None:
    fixed = resolve_for_card(AnchorRequest.from_fields(fields | {"v_max": 2.0 + 1e-7}), card)
    assert limits_of(fixed).v_max == 2.0
    for asked in (edge * (1 - 1e-7), edge * (1 + 1e-7)):
        resolved = resolve_for_card(AnchorRequest.from_fields(fields | {"v_max": asked}), free)
        assert limits_of(resolved).v_max == pytest.approx(edge, rel=2e-7)
        assert 0.1 <= limits_of(resolved).v_max <= 6.0


WARM = {"trajectory": [[-3.0, 0.5], [0.0, 0.5], [3.0, 0.5]]}


@pytest.mark.parametrize(
    ("asked", "dt"),
    [
        ({"warm_start": WARM}, None),
        ({"warm_start": WARM, "horizon_s": 12.0}, 6.0),
        ({"warm_start": WARM | {"dt": 0.4}, "horizon_s": 12.0}, 0.4),
        ({"warm_start": WARM | {"dt": 0.4}}, 0.4),
    ],
)
def test_a_warm_start_spans_the_horizon_unless_it_says_how_fast_it_is(
    fields: dict[str, Any], free: ModelCard, asked: dict[str, Any], dt: float | None
) -> None:
    warm_start = resolve_for_card(AnchorRequest.from_fields(fields | asked), free).warm_start

    assert warm_start is not None
    assert warm_start.dt == dt


def test_own_time_steps_may_be_named_as_an_output(
    fields: dict[str, Any], card: ModelCard, free: ModelCard
) -> None:
    request = AnchorRequest.from_fields(fields | {"outputs": ["dt"]})

    assert resolve_for_card(request, free).outputs == ("dt",)
    with pytest.raises(InvalidRequest, match=r"outputs: expected one of .* got the string 'dt'"):
        resolve_for_card(request, card)


PLANAR = {"x_curr": [-3.0, 0.5, *[0.0] * 4], "x_goal": [3.0, 0.5, *[0.0] * 2]}
TURNING = {"x_curr": [-3.0, 0.5, *[0.0] * 7], "x_goal": [3.0, 0.5, *[0.0] * 4]}


@pytest.mark.parametrize(
    ("dim", "states", "words"),
    [
        (
            2,
            TURNING,
            r"\[6\] or \[B,6\], as lines 1.2.3 has D = 2 without kinematics or footprint, got",
        ),
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
