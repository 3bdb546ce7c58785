"""From what a control loop sees to the request that is sent: local goal, warm start, budget."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anchorflow_client.contract import (
    AnchorBatch,
    AnchorRequest,
    CostMap,
    RefineChoice,
    SamplerChoice,
    WarmStart,
)
from anchorflow_client.contract.arrays import MAX_DIMENSIONS, unshared, wrong_shape
from anchorflow_client.contract.checks import as_array, number
from anchorflow_client.contract.ranges import (
    DIMENSIONS,
    GOAL_FIELDS,
    HORIZON,
    STATE_FIELDS,
)
from anchorflow_client.contract.request import read_states
from anchorflow_client.errors import InvalidRequest
from anchorflow_client.planner.clearance import SHARE_OF_CELL, start_clearance
from anchorflow_client.planner.config import PlannerConfig
from anchorflow_client.planner.local_goal import local_goal
from anchorflow_client.planner.robot_limits import RobotLimits
from anchorflow_client.planner.shift import shifted, states_of

Array = NDArray[np.float64]

ROUNDING = 1e-3
"""m that anchors may come nearer to an obstacle than their start, where that is too near to it."""


@dataclass(frozen=True, eq=False)
class Observation:
    """What the loop saw at one moment; a copy, which it may not change any more."""

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
        """With copies of the loop's own map and options; options that are None are left out.

        Raises:
            InvalidRequest: there is no map, or what should be an array is none.
        """
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
    """s, when the state from which it starts was seen."""

    def left(self, now: float) -> Array | None:
        """[T,3D], what is left of it at `now` at its own time step; None where nothing is."""
        duration_s = float(self.batch.durations[self.index])
        if now - self.seen_at >= duration_s:
            return None
        states = states_of(self.batch)[self.index]
        dt = duration_s / (len(states) - 1)
        left_dt = dt - (now - self.seen_at) / (len(states) - 1)
        return shifted(states, dt=dt, elapsed_s=now - self.seen_at, later_dt=left_dt)

    def warm_start(
        self, now: float, tau: float, *, horizon_s: float | None = None
    ) -> WarmStart | None:
        """What is left of it at `now`; None where nothing is.

        It lasts as long as the next anchors will: for the horizon that is asked for, else for that
        of its own batch, else, where each anchor has its own duration, until its own end.
        """
        states = states_of(self.batch)[self.index]
        strides, duration_s = len(states) - 1, float(self.batch.durations[self.index])
        left_s = duration_s - (now - self.seen_at)
        if left_s <= 0.0:
            return None
        own_s = left_s if np.ndim(self.batch.dt) else duration_s
        lasts_s = own_s if horizon_s is None else number(horizon_s, "horizon_s", HORIZON)
        left = shifted(
            states,
            dt=duration_s / strides,
            elapsed_s=now - self.seen_at,
            later_dt=lasts_s / strides,
        )
        fields = {"trajectory": left, "tau": tau, "dt": lasts_s / strides}
        return WarmStart.from_fields(fields, dim=left.shape[-1] // 3)


def states_seen(x_curr: ArrayLike, x_goal: ArrayLike) -> tuple[Array, Array]:
    """[3D] and [2D], copies. Raises `InvalidRequest` where they are not those of one robot."""
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
    """The request; what `seen.options` says goes before what is added here.

    limits: how fast a local goal is passed at most, and what it has to keep from obstacles
    in_use: to start from; None: from noise
    stop: plan to stand at a local goal that would be passed

    Raises:
        InvalidRequest: what was seen breaks the contract, or the map has no room for a goal.
    """
    cost_map = CostMap.from_fields(seen.cost_map)
    if cost_map.data.ndim != 3:
        raise wrong_shape("cost_map.data", "[C,H,W]", cost_map.data)
    place, share = seen.x_curr[:2], SHARE_OF_CELL * cost_map.resolution
    margin, passage_m = margin_asked(seen, config), None
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
    warm_start = in_use and in_use.warm_start(
        seen.seen_at, config.warm_tau, horizon_s=seen.options.get("horizon_s")
    )
    added = {"budget_ms": budget_ms, "warm_start": warm_start} | dict(seen.options)
    refine = RefineChoice.from_fields(added.get("refine", {}))
    if config.margin_m > 0.0 and refine.certified_margin is None:
        if limits.radius is not None:  # where the start keeps less, no anchor keeps it
            room = start_clearance(cost_map, place, limits.radius) - share - ROUNDING
            margin = min(margin, max(room, 0.0))
        added["refine"] = replace(refine, certified_margin=margin)
    return AnchorRequest.build(
        cost_map=cost_map, x_curr=seen.x_curr, x_goal=goal, **added, request_id=request_id
    )


def margin_asked(seen: Observation, config: PlannerConfig) -> float:
    """m beyond the robot's radius: the request's own or, where it says none, the planner's."""
    own = RefineChoice.from_fields(seen.options.get("refine", {})).certified_margin
    return config.margin_m if own is None else own


def _copied(value: Any, field: str, depth: int = 1 + MAX_DIMENSIONS) -> Any:
    """The same, of which its owner can change nothing; what is nested deeper is refused later."""
    if not depth or isinstance(value, np.generic):
        return value
    if isinstance(value, CostMap | WarmStart | SamplerChoice | RefineChoice):
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
