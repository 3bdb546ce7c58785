"""From what a control loop sees to the request that is sent: local goal, warm start, budget."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anchorflow_client.contract import AnchorBatch, AnchorRequest, CostMap, WarmStart
from anchorflow_client.contract.ranges import DEFAULT_TAU
from anchorflow_client.errors import InvalidRequest
from anchorflow_client.planner_goal import local_goal
from anchorflow_client.planner_shift import shifted, states_of

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class RequestConfig:
    """What a `Planner` adds to what the loop sees."""

    goal_clearance_m: float = 0.35
    """Of the local goal, from obstacles and from the map's edge; at least the robot's radius."""
    through_speed: float = 1.0
    """m/s at a local goal that stands in for one beyond the map."""
    warm_tau: float = DEFAULT_TAU
    """Flow time at which a warm start enters, in (0, 1)."""
    cold_every: int = 3
    """Every so manieth request starts from noise, to find other ways; 1: all of them."""

    def __post_init__(self) -> None:
        """Raises `ValueError` where a setting is out of range."""
        if not 0.0 < self.warm_tau < 1.0:
            raise ValueError(f"warm_tau: expected a number in (0, 1), got {self.warm_tau}")
        if self.cold_every < 1:
            raise ValueError(f"cold_every: expected at least 1, got {self.cold_every}")
        if not (self.goal_clearance_m >= 0.0 and self.through_speed >= 0.0):
            raise ValueError(
                "goal_clearance_m, through_speed: expected numbers from 0, "
                f"got {self.goal_clearance_m}, {self.through_speed}"
            )


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
        *,
        cost_map: CostMap | Mapping[str, Any] | ArrayLike,
        x_curr: ArrayLike,
        x_goal: ArrayLike,
        **options: Any,
    ) -> Observation:
        """A copy of the loop's own arrays; `cost_map` as in `AnchorClient.plan`."""
        resolution, origin = options.pop("resolution", None), options.pop("origin", None)
        if not isinstance(cost_map, CostMap | Mapping):
            data = np.array(cost_map)
            data = data[None] if data.ndim == 2 else data
            cost_map = {"data": data, "resolution": resolution, "origin": origin}
        elif resolution is not None or origin is not None:
            raise InvalidRequest("expected resolution and origin inside this map only", "cost_map")
        elif isinstance(cost_map, Mapping):
            cost_map = {**cost_map, "data": np.array(cost_map.get("data"))}
        start, goal = np.array(x_curr, np.float64), np.array(x_goal, np.float64)
        for name, vector in (("x_curr", start), ("x_goal", goal)):
            if vector.ndim != 1:
                raise InvalidRequest(f"expected one vector, got shape {list(vector.shape)}", name)
        return cls(seen_at, cost_map, start, goal, options)


@dataclass(frozen=True, eq=False)
class AnchorInUse:
    """The anchor that the loop follows."""

    batch: AnchorBatch
    index: int
    seen_at: float
    """s, when the state from which it starts was seen."""

    def warm_start(self, now: float, tau: float) -> WarmStart | None:
        """What is left of it at `now`; None where nothing is."""
        states = states_of(self.batch)[self.index]
        horizon_s = self.batch.dt * (len(states) - 1)
        if now - self.seen_at >= horizon_s:
            return None
        left = shifted(states, dt=self.batch.dt, elapsed_s=now - self.seen_at)
        return WarmStart.from_fields({"trajectory": left, "tau": tau}, dim=left.shape[-1] // 3)


def build_request(
    seen: Observation,
    config: RequestConfig,
    *,
    request_id: str,
    budget_ms: float,
    in_use: AnchorInUse | None,
) -> AnchorRequest:
    """The request; what `seen.options` says goes before what is added here.

    in_use: to start from; None: from noise

    Raises:
        InvalidRequest: what was seen breaks the contract, or the map has no room for a goal.
    """
    cost_map = CostMap.from_fields(seen.cost_map)
    goal = local_goal(
        cost_map,
        seen.x_curr[:2],
        seen.x_goal,
        clearance_m=config.goal_clearance_m,
        through_speed=config.through_speed,
    )
    warm_start = in_use and in_use.warm_start(seen.seen_at, config.warm_tau)
    added = {"budget_ms": budget_ms, "warm_start": warm_start} | dict(seen.options)
    return AnchorRequest.build(
        cost_map=cost_map, x_curr=seen.x_curr, x_goal=goal, **added, request_id=request_id
    )
