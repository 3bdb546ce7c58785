"""Complete a request by the defaults of a model card, or refuse what the card does not allow."""

from __future__ import annotations

import math
import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from anchorflow_client.contract.card import (
    CostMapSpec,
    FinishSpec,
    GuardSpec,
    LimitsSpec,
    ModelCard,
    OdeSpec,
    RefineSpec,
    SamplerSpec,
    TruncatedDiffusionSpec,
    VocabularySpec,
)
from anchorflow_client.contract.checks import choice, vector_shape
from anchorflow_client.contract.fields import (
    BODY_OPTIONS,
    DEFAULT_COST_PENALTY,
    DEFAULT_NUM_SAMPLES,
    LIMITS,
    MAP_FIELDS,
    MAP_OPTIONS,
    NUM_SAMPLES,
    STATE_FIELDS,
    RefineChoice,
    SamplerChoice,
    WarmStart,
)
from anchorflow_client.contract.inputs import bind
from anchorflow_client.contract.request import AnchorRequest
from anchorflow_client.errors import InvalidRequest

POSE = ("x", "y", "heading")
DRAWN_SEED_BITS = 53
"""JavaScript and other JSON readers hold integers of so few bits exactly."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ResolvedRequest(AnchorRequest):
    """A request with a value in every field."""

    num_samples: int = field()
    cost_penalty: float = field()
    clear_start: bool = field()
    delay_s: float = field()
    model: str = field()
    seed: int = field()
    sampler: SamplerSpec = field()  # pyright: ignore[reportIncompatibleVariableOverride]
    refine: FinishSpec = field()  # pyright: ignore[reportIncompatibleVariableOverride]
    limits: LimitsSpec | None = None
    """The limits of the anchors, with horizon_s None if each has its own duration; None for a
    planner without a cost map."""

    @property
    def certified_margin(self) -> float:
        """m beyond robot_radius that every safe anchor keeps; 0 without a finish."""
        return self.refine.certified_margin if isinstance(self.refine, RefineSpec) else 0.0


def resolve_for_card(request: AnchorRequest, card: ModelCard) -> ResolvedRequest:
    """Complete a request by a card's defaults; a resolved request comes back unchanged.

    A seed is drawn where none is given.

    Raises:
        InvalidRequest: the inputs are not the card's; the request states what the card's
            conditioning, sampler or finish has no use for, or what the card does not let change.
    """
    if isinstance(request, ResolvedRequest):
        return request
    for name in request.outputs:
        choice(name, "outputs", card.outputs)
    filled: dict[str, Any] = {
        "num_samples": _num_samples(request, card.sampler),
        "cost_penalty": DEFAULT_COST_PENALTY
        if request.cost_penalty is None
        else request.cost_penalty,
        "clear_start": bool(request.clear_start),
        "delay_s": _delay_s(request, card),
        "model": request.model or card.name,
        "seed": secrets.randbits(DRAWN_SEED_BITS) if request.seed is None else request.seed,
        "sampler": _sampler(request, card),
        "refine": _finish(request, card),
        **_conditions(request, card),
    }
    return ResolvedRequest(**(request.field_values() | filled))


def _conditions(request: AnchorRequest, card: ModelCard) -> dict[str, Any]:
    """Check the fields of the planner's conditioning."""
    if isinstance(card.conditioning, CostMapSpec):
        _check_map_fields(request, card)
        _refuse_with_body(request)
        limits = _limits(request, card, card.conditioning)
        return {"limits": limits, "warm_start": _warm_start(request.warm_start, limits)}
    _refuse_map_fields(request, card)
    inputs, num_scenes, batched = bind(request.inputs, card.inputs)
    if request.last_plan is not None and num_scenes > 1:
        raise InvalidRequest(
            f"expected none with several scenes, got B = {num_scenes}", "last_plan"
        )
    return {"inputs": inputs, "num_scenes": num_scenes, "batched": batched}


def _check_map_fields(request: AnchorRequest, card: ModelCard) -> None:
    if request.inputs:
        name = next(iter(request.inputs))
        known = ", ".join(MAP_FIELDS)
        raise InvalidRequest(
            f"unknown to {card.name}, which is asked with {known}", f"inputs.{name}"
        )
    dim = len(POSE) if request.has_body else card.D
    if request.on_map.dim == dim:
        return
    size = request.x_curr.shape[1]
    got = f"[{request.num_scenes},{size}]" if request.batched else f"[{size}]"
    if request.has_body:
        asks = next(name for name in BODY_OPTIONS if getattr(request, name) is not None)
        why = f"as {asks} asks for poses, x, y and heading"
    else:
        why = f"as {card.name} {card.version} has D = {card.D}"
        if request.on_map.dim == len(POSE):
            why += " without kinematics or footprint"
    shape = vector_shape(STATE_FIELDS * dim)
    raise InvalidRequest(f"expected shape {shape}, {why}, got {got}", "x_curr")


def _refuse_with_body(request: AnchorRequest) -> None:
    """Refuse what the search of poses has no use for."""
    for name in ("warm_start", "sampler"):
        if request.has_body and getattr(request, name) is not None:
            message = "expected none with a footprint or kinematics, whose poses are not sampled"
            raise InvalidRequest(message, name)


def _refuse_map_fields(request: AnchorRequest, card: ModelCard) -> None:
    """Refuse fields that only a planner with a cost map uses."""
    named = {"cost_map": request.map_scenes, "warm_start": request.warm_start}
    named |= {name: getattr(request, name) for name in MAP_OPTIONS}
    for name, value in named.items():
        if value is not None:
            names = ", ".join(f"inputs.{spec.name}" for spec in card.inputs)
            raise InvalidRequest(f"unknown to {card.name}, which is asked with {names}", name)


def _delay_s(request: AnchorRequest, card: ModelCard) -> float:
    """Return the delay of a plan, which planners of cars have; 0 without one."""
    for name in ("delay_s", "last_plan"):
        if getattr(request, name) is not None and not isinstance(card.finish, GuardSpec):
            own = f"the finish of {card.name} is of kind {card.finish.kind!r}"
            takes = f"only planners of cars whose finish is of kind {GuardSpec.kind!r} take it"
            raise InvalidRequest(f"expected none, as {own}, and {takes}", name)
    delay_s, plan = request.delay_s or 0.0, request.last_plan
    if plan is None:
        return delay_s
    if request.delay_s is None:
        raise InvalidRequest("this field is required beside last_plan", "delay_s")
    if plan[-1, 0] < delay_s:
        message = f"expected a last time of at least delay_s = {delay_s:g} s"
        raise InvalidRequest(f"{message}, got {plan[-1, 0]:g} s", "last_plan")
    return delay_s


def _num_samples(request: AnchorRequest, sampler: SamplerSpec) -> int:
    """Return N; a sampler with a fixed number of trajectories limits it."""
    chooses = isinstance(sampler, VocabularySpec | TruncatedDiffusionSpec)
    most = sampler.size if chooses else int(NUM_SAMPLES.high)
    if request.num_samples is None:
        return min(DEFAULT_NUM_SAMPLES, most)
    if request.num_samples > most:
        message = f"expected 1 to {most}, the trajectories that there are to choose from"
        raise InvalidRequest(f"{message}, got {request.num_samples}", "num_samples")
    return request.num_samples


def _sampler(request: AnchorRequest, card: ModelCard) -> SamplerSpec:
    if isinstance(card.sampler, OdeSpec):
        return (request.sampler or SamplerChoice()).over(card.sampler)
    if isinstance(card.sampler, TruncatedDiffusionSpec):
        return card.sampler.chosen(request.sampler or SamplerChoice())
    if request.sampler is not None:
        raise _not_chosen(card, "sampler", card.sampler.kind)
    return card.sampler


def _finish(request: AnchorRequest, card: ModelCard) -> FinishSpec:
    if isinstance(card.finish, RefineSpec):
        asked = request.refine or RefineChoice()
        for name in ("guard", "route_drives"):
            if getattr(asked, name) is not None:
                raise _not_chosen(card, f"refine.{name}", card.finish.kind)
        finish = asked.over(card.finish)
        if asked.smooth is False and (finish.project or finish.barrier):
            moves = "project" if finish.project else "barrier"
            message = f"expected true, or refine.{moves} false: it moves the fitted spline"
            raise InvalidRequest(f"{message}, got false", "refine.smooth")
        return finish
    if isinstance(card.finish, GuardSpec):
        return card.finish.chosen(request.refine or RefineChoice())
    if request.refine is not None:
        raise _not_chosen(card, "refine", card.finish.kind)
    return card.finish


def _not_chosen(card: ModelCard, field: str, kind: str) -> InvalidRequest:
    own = f"{card.name}, whose kind is {kind!r}"
    return InvalidRequest(f"expected none, as nothing of it is a request's choice in {own}", field)


def _limits(request: AnchorRequest, card: ModelCard, own: CostMapSpec) -> LimitsSpec:
    limits: dict[str, Any] = {**vars(own.limits)}
    for name, limit in limits.items():
        limits[name] = _limit(name, request, card, limit)
    return LimitsSpec(**limits)


def _limit(name: str, request: AnchorRequest, card: ModelCard, own: float | None) -> float | None:
    asked = getattr(request, name)
    # Callers keep limits in float32: 0.3 must not be refused as 0.30000001.
    if asked is None or (own is not None and math.isclose(asked, own, rel_tol=1e-6)):
        return own
    made_for, unit = f"which {card.name} {card.version}", LIMITS[name].unit
    ranges: Mapping[Any, tuple[float, float]] = card.cost_map.ranges
    if name not in ranges:
        only = "none, as each anchor has its own" if own is None else f"{own:g} {unit}"
        expected = f"expected {only}, {made_for} was made for and its card does not let change"
        raise InvalidRequest(f"{expected}, got {asked:g}", name)
    low, high = ranges[name]
    nearest = min(max(asked, low), high)
    if math.isclose(asked, nearest, rel_tol=1e-6):
        return nearest
    expected = f"expected {low:g} to {high:g} {unit}, for {made_for} was trained"
    raise InvalidRequest(f"{expected}, got {asked:g}", name)


def _warm_start(warm_start: WarmStart | None, limits: LimitsSpec) -> WarmStart | None:
    """Spread its samples over the horizon if there is one and the request gives no dt."""
    if warm_start is None or warm_start.dt is not None or limits.horizon_s is None:
        return warm_start
    return replace(warm_start, dt=limits.horizon_s / (len(warm_start.trajectory) - 1))
