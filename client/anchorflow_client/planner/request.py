"""Turn a control loop's observation into a request: local goal, warm start, limits and budget."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anchorflow_client.contract import (
    AnchorBatch,
    AnchorRequest,
    CostMap,
    CostMapSpec,
    GoalTolerance,
    ModelCard,
    Obstacles,
    RefineChoice,
    SamplerChoice,
    WarmStart,
)
from anchorflow_client.contract.body import inner_radius, read_footprint
from anchorflow_client.contract.checks import (
    MAX_DIMENSIONS,
    as_array,
    number,
    text,
    unshared,
    wrong_shape,
)
from anchorflow_client.contract.fields import (
    BODY_OPTIONS,
    DIMENSIONS,
    GOAL_FIELDS,
    HORIZON,
    ROBOT_RADIUS,
    STATE_FIELDS,
    V_MAX,
)
from anchorflow_client.contract.obstacles import LATER
from anchorflow_client.contract.request import read_states
from anchorflow_client.errors import AnchorFlowError, InvalidRequest
from anchorflow_client.planner.config import PlannerConfig
from anchorflow_client.planner.local_goal import SHARE_OF_CELL, local_goal, start_clearance
from anchorflow_client.planner.plan import shifted, states_of

Array = NDArray[np.float64]

ROUNDING = 1e-3
"""m by which anchors may come nearer to an obstacle than a start that is too near to it."""


class AnchorSource(Protocol):
    """Answers requests: `AnchorClient`, or another client of the same interface."""

    def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        """Block until there is an answer. Raises `AnchorFlowError` if there is none."""
        ...


@dataclass(frozen=True, eq=False)
class Observation:
    """A copy of the loop's inputs at one moment, which the loop cannot change any more."""

    seen_at: float
    """s, on the planner's clock."""
    cost_map: CostMap | Mapping[str, Any]
    x_curr: Array
    """[3D]."""
    x_goal: Array
    """[2D]."""
    options: Mapping[str, Any]
    """Further fields of the request."""

    @classmethod
    def copied(
        cls,
        seen_at: float,
        cost_map: CostMap | Mapping[str, Any] | None,
        *,
        x_curr: Array,
        x_goal: Array,
        options: Mapping[str, Any],
    ) -> Observation:
        """Copy the loop's map and the options that are not None. Raises `InvalidRequest`."""
        if cost_map is None:
            raise InvalidRequest("expected a map to plan on, got none", "cost_map")
        if not isinstance(cost_map, CostMap):
            cost_map = {**cost_map, "data": as_array(cost_map.get("data"), "cost_map.data")}
        given = {name: _copied(value, name) for name, value in options.items() if value is not None}
        return cls(seen_at, _copied(cost_map, "cost_map"), x_curr, x_goal, given)


@dataclass(frozen=True, eq=False)
class AnchorInUse:
    """The anchor that the loop follows."""

    batch: AnchorBatch
    index: int
    seen_at: float
    """s, the time of the state from which it starts."""

    def left(self, now: float) -> Array | None:
        """Return [T,3D], the rest of it at `now` with its own duration; None if it has ended."""
        if self.left_s(now) <= 0.0:
            return None
        dt = self._duration_s / self._strides
        return self._rest(now, dt - (now - self.seen_at) / self._strides)

    def left_s(self, now: float) -> float:
        """Return the seconds from `now` to its end, below 0 after it."""
        return self._duration_s - (now - self.seen_at)

    def warm_start(
        self, now: float, tau: float, *, horizon_s: float | None = None
    ) -> WarmStart | None:
        """Return the rest of it at `now` as a warm start; None if it has ended.

        It lasts as long as the next anchors will: the request's horizon, else the horizon of its
        own batch, else, if each anchor has its own duration, until its own end.
        """
        left_s = self.left_s(now)
        if left_s <= 0.0:
            return None
        own_s = left_s if np.ndim(self.batch.dt) else self._duration_s
        lasts_s = own_s if horizon_s is None else number(horizon_s, "horizon_s", HORIZON)
        dt = lasts_s / self._strides
        rest = self._rest(now, dt)
        return WarmStart.from_fields(
            {"trajectory": rest, "tau": tau, "dt": dt}, dim=rest.shape[-1] // 3
        )

    @property
    def _duration_s(self) -> float:
        return float(self.batch.durations[self.index])

    @property
    def _strides(self) -> int:
        return self.batch.trajectories.shape[-2] - 1

    def _rest(self, now: float, later_dt: float) -> Array:
        """Return [T,3D], its states from `now` on, `later_dt` s apart."""
        return shifted(
            states_of(self.batch)[self.index],
            dt=self._duration_s / self._strides,
            elapsed_s=now - self.seen_at,
            later_dt=later_dt,
        )


LOCAL_GOAL_M = 0.3
"""How far from a local goal a body may end."""


class RobotLimits(NamedTuple):
    """v_max: m/s, infinite if unknown; radius: m, None if unknown; a footprint's inner one."""

    v_max: float
    radius: float | None


class LimitsSource:
    """Reads limits from a request's options or, if they lack them, from its model's card."""

    def __init__(self, client: AnchorSource) -> None:
        self._client = client
        self._cards: tuple[ModelCard, ...] = ()

    def of(self, options: Mapping[str, Any]) -> RobotLimits:
        """Return the limits for a request with these options. Raises `InvalidRequest`."""
        v_max, radius = options.get("v_max"), options.get("robot_radius")
        v_max = None if v_max is None else number(v_max, "v_max", V_MAX)
        radius = None if radius is None else number(radius, "robot_radius", ROBOT_RADIUS)
        if (footprint := options.get("footprint")) is not None:
            radius = inner_radius(read_footprint(footprint))
        if v_max is None or radius is None:
            model = options.get("model")
            card = self._card(None if model is None else text(model, "model"))
            if card is not None and isinstance(card.conditioning, CostMapSpec):
                own = card.conditioning.limits
                v_max = own.v_max if v_max is None else v_max
                radius = own.robot_radius if radius is None else radius
        return RobotLimits(math.inf if v_max is None else v_max, radius)

    def _card(self, model: str | None) -> ModelCard | None:
        """Return the card of that name, or the default's for None; fetch cards it lacks."""
        if (known := _named(model, self._cards)) is not None:
            return known
        if models := getattr(self._client, "models", None):
            try:
                self._cards = models()
            except AnchorFlowError:  # the request that follows does without, or fails likewise
                return None
        return _named(model, self._cards)


def _named(model: str | None, cards: tuple[ModelCard, ...]) -> ModelCard | None:
    return next((card for card in cards if model in (None, card.name)), None)


def read_own_states(x_curr: ArrayLike, x_goal: ArrayLike) -> tuple[Array, Array]:
    """Return copies [3D] and [2D]. Raises `InvalidRequest` if they are not those of one robot."""
    start = _state(x_curr, "x_curr", STATE_FIELDS, *DIMENSIONS)
    return start, _state(x_goal, "x_goal", GOAL_FIELDS, len(start) // STATE_FIELDS)


def build_request(
    seen: Observation,
    config: PlannerConfig,
    *,
    request_id: str,
    budget_ms: float,
    limits: RobotLimits,
    in_use: AnchorInUse | None,
    stop: bool = False,
) -> AnchorRequest:
    """Build the request; `seen.options` override the fields that are added here.

    limits: the highest speed at a local goal, and the radius that keeps from obstacles
    in_use: the anchor to start from; None: from noise
    stop: stop at a local goal that would be passed

    Raises `InvalidRequest`, also if the map has no room for a goal.
    """
    cost_map = CostMap.from_fields(seen.cost_map)
    if cost_map.data.ndim != 3:
        raise wrong_shape("cost_map.data", "[C,H,W]", cost_map.data)
    place, share = seen.x_curr[:2], SHARE_OF_CELL * cost_map.resolution
    margin, passage_m = requested_margin(seen, config), None
    if limits.radius is not None:
        passage_m = limits.radius + margin + share
    goal = local_goal(
        cost_map,
        place,
        seen.x_goal,
        clearance_m=max(config.goal_clearance_m, passage_m or 0.0),
        through_speed=0.0 if stop else min(config.through_speed, limits.v_max),
        passage_m=passage_m,
    )
    warm_start = None
    if in_use is not None and seen.options.keys().isdisjoint(BODY_OPTIONS):  # poses are not sampled
        warm_start = in_use.warm_start(
            seen.seen_at, config.warm_tau, horizon_s=seen.options.get("horizon_s")
        )
    added = {"budget_ms": budget_ms, "warm_start": warm_start} | dict(seen.options)
    if not seen.options.keys().isdisjoint(BODY_OPTIONS) and (goal[:2] != seen.x_goal[:2]).any():
        added["goal_tolerance"] = GoalTolerance(LOCAL_GOAL_M)  # any heading will do on the way
    refine = RefineChoice.from_fields(added.get("refine", {}))
    if config.margin_m > 0.0 and refine.certified_margin is None:
        if limits.radius is not None:  # no anchor can keep more than its start
            room = start_clearance(cost_map, place, limits.radius) - share - ROUNDING
            margin = min(margin, max(room, 0.0))
        added["refine"] = replace(refine, certified_margin=margin)
    return AnchorRequest.build(
        cost_map=cost_map, x_curr=seen.x_curr, x_goal=goal, **added, request_id=request_id
    )


def at_the_state(obstacles: Obstacles | Mapping[str, Any], age_s: float) -> Obstacles:
    """Return obstacles `age_s` after they were observed. Raises `InvalidRequest`."""
    age_s = number(age_s, "obstacles_age_s", LATER)
    observed = Obstacles.from_fields(obstacles)
    return observed.later(age_s) if age_s > 0.0 else observed


def requested_margin(seen: Observation, config: PlannerConfig) -> float:
    """Return m beyond the robot's radius: the request's own or, if it has none, the planner's."""
    own = RefineChoice.from_fields(seen.options.get("refine", {})).certified_margin
    return config.margin_m if own is None else own


def _copied(value: Any, field: str, depth: int = 1 + MAX_DIMENSIONS) -> Any:
    """Copy a field, so that its owner cannot change it; deeper nesting is refused later."""
    if not depth or isinstance(value, np.generic):
        return value
    if isinstance(value, CostMap | WarmStart | SamplerChoice | RefineChoice | GoalTolerance):
        return replace(value, **_copied(vars(value), field, depth))
    if isinstance(value, Mapping):
        return {name: _copied(each, f"{field}.{name}", depth - 1) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_copied(each, field, depth - 1) for each in value]
    return unshared(as_array(value, field)) if hasattr(value, "__array__") else value


def _state(value: ArrayLike, field: str, parts: int, *dims: int) -> Array:
    state = read_states(as_array(value, field, np.float64), field, parts, *dims)
    if state.ndim != 1:
        raise InvalidRequest(f"expected one vector, got shape {list(state.shape)}", field)
    return state
