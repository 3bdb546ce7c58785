"""What `plan` takes, spelled out once for blocking and async clients."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from anchorflow_client.contract import (
    AnchorRequest,
    CostMap,
    RefineChoice,
    SamplerChoice,
    WarmStart,
)
from anchorflow_client.errors import InvalidRequest

Answer = TypeVar("Answer")


class PlanKeywords(ABC, Generic[Answer]):
    """Has `plan`; its `Answer` is a batch, or for an async client a batch to be awaited."""

    def plan(
        self,
        *,
        cost_map: CostMap | Mapping[str, Any] | ArrayLike | None = None,
        x_curr: ArrayLike | None = None,
        x_goal: ArrayLike | None = None,
        resolution: float | None = None,
        origin: ArrayLike | None = None,
        w_style: str | ArrayLike | None = None,
        num_samples: int | None = None,
        robot_radius: float | None = None,
        v_max: float | None = None,
        a_max: float | None = None,
        horizon_s: float | None = None,
        model: str | None = None,
        seed: int | None = None,
        sampler: SamplerChoice | Mapping[str, Any] | None = None,
        refine: RefineChoice | Mapping[str, Any] | None = None,
        warm_start: WarmStart | Mapping[str, Any] | None = None,
        budget_ms: float | None = None,
        robot_id: str | None = None,
        request_id: str | None = None,
        inputs: Mapping[str, Any] | None = None,
        outputs: Sequence[str] | None = None,
    ) -> Answer:
        """Anchors: from a state to a goal on a map, or for the inputs that the model's card lists.

        None leaves a field to the service or the card.

        Args:
            cost_map: a CostMap, {"data", "resolution", "origin"}, or an array [H,W], [C,H,W] or
                [B,C,H,W] in [0, 1] beside `resolution` and `origin`.
            x_curr: [3D] or [B,3D] position in m, velocity within ±100 m/s, acceleration within
                ±100 m/s^2; D is the model's: 2 (x, y) or 3 (x, y, heading in rad, which runs on
                beyond ±π).
            x_goal: [2D] or [B,2D] position, velocity.
            resolution: m/cell, with an array.
            origin: [2] m, outer corner of cell (0, 0), with an array; None centres the map.
            w_style: "conservative", "balanced", "efficient" or "comfortable"; or [3] or [B,3]
                weights of safety, energy and smoothness from 0, made to sum to 1.
            num_samples: N, anchors a scene.
            robot_radius: m. This and the next three inside the ranges that the card tells.
            v_max: m/s.
            a_max: m/s^2.
            horizon_s: s from the first to the last time step of every anchor; None: the card's or,
                where that has none, each anchor's own.
            model: name of the bundle that answers.
            seed: of the noise; the answer echoes it, and the same seed gives the same anchors.
            sampler: {"method", "schedule"}, the flow's solver and the times it visits.
            refine: {"smooth", "project", "safety_margin", "guidance", "barrier",
                "certified_margin"}, how samples are finished.
            warm_start: {"trajectory", "tau", "dt"}, a trajectory [T,D] to [T,3D] to start from, the
                flow time at which it enters, and the s between two of its samples.
            budget_ms: time left to the caller; who cannot answer within it drops the request.
            robot_id: who asks; a newer request of the same robot supersedes one that still waits.
            request_id: echoed in the answer, and in the service's log.
            inputs: what a planner without a cost map is asked with, by the names of its card.
            outputs: names of extras of the card to be sent along.

        Raises:
            InvalidRequest: before anything is sent, where a field breaks the contract.
        """
        return self._plan_built(
            lambda: AnchorRequest.build(
                cost_map=map_fields(cost_map, resolution, origin),
                x_curr=x_curr,
                x_goal=x_goal,
                w_style=w_style,
                num_samples=num_samples,
                robot_radius=robot_radius,
                v_max=v_max,
                a_max=a_max,
                horizon_s=horizon_s,
                model=model,
                seed=seed,
                sampler=sampler,
                refine=refine,
                warm_start=warm_start,
                budget_ms=budget_ms,
                robot_id=robot_id,
                request_id=request_id,
                inputs=inputs,
                outputs=outputs,
            )
        )

    @abstractmethod
    def _plan_built(self, build: Callable[[], AnchorRequest]) -> Answer:
        """Anchors for the request that `build` gives, or its refusal, where the answer is had."""


def map_fields(
    cost_map: CostMap | Mapping[str, Any] | ArrayLike | None,
    resolution: float | None,
    origin: ArrayLike | None,
) -> CostMap | Mapping[str, Any] | None:
    """A map in one of the forms of `plan` as one that `AnchorRequest` takes; nothing is copied.

    Raises:
        InvalidRequest: a map that knows its own place, or none at all, comes with a place.
    """
    if cost_map is None or isinstance(cost_map, CostMap | Mapping):
        if resolution is not None or origin is not None:
            raise InvalidRequest("expected resolution and origin inside this map only", "cost_map")
        return cost_map
    try:
        data = np.asarray(cost_map)
    except (TypeError, ValueError, RuntimeError):  # whoever reads it tells why, and where
        return {"data": cost_map, "resolution": resolution, "origin": origin}
    data = data[None] if data.ndim == 2 else data
    return {"data": data, "resolution": resolution, "origin": origin}
