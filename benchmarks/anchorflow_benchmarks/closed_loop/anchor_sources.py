"""Who proposes anchors beside a client: straight lines, a search for routes, a bad connection."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_benchmarks.baselines import minimum_jerk
from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.planners import scene_of
from anchorflow_benchmarks.routes_planner import RoutesPlanner
from anchorflow_client.contract import (
    DEFAULT_NUM_SAMPLES,
    AnchorBatch,
    AnchorRequest,
    ModelId,
    resolve_for_card,
)
from anchorflow_client.errors import ConnectionFailed
from anchorflow_client.planner import AnchorSource
from anchorflow_service.bundle import Bundle
from anchorflow_service.bundle.manifest import SplineEntry

PEAK_SPEED, PEAK_ACCELERATION = 1.875, 10.0 / 3**0.5  # of minimum jerk, times L / T and L / T^2
V_MAX, A_MAX = 2.0, 3.0  # m/s and m/s^2, where a request says nothing
LEAST_S = 0.5  # that a line lasts


@dataclass(frozen=True)
class LinesSource:
    """A straight line to the goal, and others that bend aside by smooth noise; blind to the map.

    horizon_s: that each lasts; None: as long as it takes at the request's limits
    spread: m, standard deviation of the first and widest of the bends
    """

    horizon_s: float | None = None
    steps: int = 64
    spread: float = 1.0
    bends: int = 4

    def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        """Only the first is straight; none knows whether it is safe."""
        num = request.num_samples or DEFAULT_NUM_SAMPLES
        rng = np.random.default_rng(request.seed)
        start, goal = request.x_curr[0, :2], request.x_goal[0, :2]
        span = goal - start
        across = np.array([-span[1], span[0]]) / max(1e-6, float(np.linalg.norm(span)))
        share, order = minimum_jerk(self.steps), np.arange(1, self.bends + 1)
        size = rng.normal(0.0, self.spread / order**2, (num, self.bends))
        size[0] = 0.0
        aside = size @ np.sin(np.pi * order[:, None] * share)
        paths = start + share[:, None] * span + aside[..., None] * across
        dt = self._durations(paths, request) / (self.steps - 1)
        step = np.asarray(dt)[..., None, None]
        velocities = np.gradient(paths, axis=1) / step
        return AnchorBatch(
            arrays={
                "trajectories": paths.astype(np.float32),
                "velocities": velocities,
                "accelerations": np.gradient(velocities, axis=1) / step,
                "scores": -(size**2).sum(1),
                "clearance": np.zeros(num),
                "safe": np.zeros(num, bool),
            },
            dt=dt,
            seed=request.seed or 0,
            model=ModelId("lines", "1", ""),
            timing_ms={},
            request_id=request.request_id,
        )

    def _durations(
        self, paths: NDArray[np.float64], request: AnchorRequest
    ) -> float | NDArray[np.float64]:
        """s, of all of [N, T, 2] or [N]."""
        if self.horizon_s is not None:
            return self.horizon_s
        lengths = np.linalg.norm(np.diff(paths, axis=1), axis=-1).sum(1)
        by_speed = PEAK_SPEED * lengths / (request.v_max or V_MAX)
        by_pull = np.sqrt(PEAK_ACCELERATION * lengths / (request.a_max or A_MAX))
        return np.maximum(np.maximum(by_speed, by_pull), LEAST_S)


@dataclass(frozen=True)
class RoutesSource:
    """Splines along the routes that a search finds on the request's map, finished as a bundle's.

    What a bundle's answer is without its network.
    """

    bundle: Bundle
    finish: SplineEntry

    @staticmethod
    def of(bundle: Bundle) -> RoutesSource:
        """Raises `BenchmarkError` where the bundle's finish is no spline."""
        finish = bundle.manifest.finish
        if not isinstance(finish, SplineEntry):
            raise BenchmarkError(
                f"{bundle.card.name}: expected a bundle whose finish is a spline, got "
                f"{finish.kind!r}"
            )
        return RoutesSource(bundle, finish)

    def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        """To the limits that the request and the card agree on. Raises `InvalidRequest`."""
        asked = resolve_for_card(request, self.bundle.card)
        scene = scene_of(asked)
        finish = self.finish.model_copy(update={"certified_margin": asked.certified_margin})
        planner = RoutesPlanner(scene.motion, finish, finish.steps)
        anchors = planner.plan(scene, num=asked.num_samples, seed=asked.seed)
        assert anchors.safe is not None  # the finish tells
        return AnchorBatch(
            arrays={
                "trajectories": anchors.positions,
                "velocities": anchors.velocities,
                "accelerations": anchors.accelerations,
                "safe": anchors.safe,
            },
            dt=anchors.dt,
            seed=asked.seed,
            model=ModelId("routes", "1", ""),
            timing_ms={},
            request_id=request.request_id,
        )


class LossySource:
    """Another source, some of whose answers are lost."""

    def __init__(self, source: AnchorSource, *, share: float, seed: int) -> None:
        """share: of the answers, in [0, 1]; seed: which of them."""
        self._source, self._share = source, share
        self._rng = np.random.default_rng([seed, 2])

    def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        """Works an answer out in any case. Raises `ConnectionFailed` where it is lost."""
        batch = self._source.plan_request(request)
        if self._rng.random() < self._share:
            raise ConnectionFailed(f"the answer to {request.request_id} was lost")
        return batch
