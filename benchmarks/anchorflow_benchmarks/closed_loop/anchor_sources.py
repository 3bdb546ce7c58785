"""Sources of anchors other than a client: straight lines, a route search, a lossy connection."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from anchorflow_benchmarks.baselines import RoutesPlanner, bend_sizes, bent_aside, spline_finish
from anchorflow_benchmarks.planners import scene_of
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

PEAK_SPEED, PEAK_ACCELERATION = 1.875, 10.0 / 3**0.5  # of minimum jerk, times L / T and L / T^2
V_MAX, A_MAX = 2.0, 3.0  # m/s and m/s^2, defaults of a request
MIN_DURATION_S = 0.5
BENDS = 4


@dataclass(frozen=True)
class LinesSource:
    """A straight line to the goal, and others bent by smooth noise; the map is ignored.

    horizon_s: duration of each; None for the shortest within the request's limits
    spread: m, standard deviation of the first and widest bend
    """

    horizon_s: float | None = None
    steps: int = 64
    spread: float = 1.0

    def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        """Return lines, the first of them straight, all with `safe` false."""
        num = request.num_samples or DEFAULT_NUM_SAMPLES
        rng = np.random.default_rng(request.seed)
        start, goal = request.x_curr[0, :2], request.x_goal[0, :2]
        span = goal - start
        across = np.array([-span[1], span[0]]) / max(1e-6, float(np.linalg.norm(span)))
        share = minimum_jerk(self.steps)
        size = bend_sizes(rng, num, spread=self.spread, bends=BENDS)
        size[0] = 0.0
        aside = bent_aside(size, share)
        paths = start + share[:, None] * span + aside[..., None] * across
        dt = self._durations(paths, request) / (self.steps - 1)
        step = np.asarray(dt)[..., None, None]
        velocities = np.gradient(paths, axis=1) / step
        arrays = {
            "trajectories": paths.astype(np.float32),
            "velocities": velocities,
            "accelerations": np.gradient(velocities, axis=1) / step,
            "scores": -(size**2).sum(1),
            "clearance": np.zeros(num),
            "safe": np.zeros(num, bool),
        }
        return _batch("lines", arrays, dt=dt, seed=request.seed or 0, request=request)

    def _durations(
        self, paths: NDArray[np.float64], request: AnchorRequest
    ) -> float | NDArray[np.float64]:
        """Return the duration in s of all paths [N, T, 2], or [N]."""
        if self.horizon_s is not None:
            return self.horizon_s
        lengths = np.linalg.norm(np.diff(paths, axis=1), axis=-1).sum(1)
        by_speed = PEAK_SPEED * lengths / (request.v_max or V_MAX)
        by_pull = np.sqrt(PEAK_ACCELERATION * lengths / (request.a_max or A_MAX))
        return np.maximum(np.maximum(by_speed, by_pull), MIN_DURATION_S)


def minimum_jerk(num_samples: int) -> NDArray[np.float64]:
    """Return shares of the way [T] at equal times, from rest to rest (Flash & Hogan, 1985)."""
    tau = np.linspace(0.0, 1.0, num_samples)
    return tau**3 * (10.0 - 15.0 * tau + 6.0 * tau**2)


@dataclass(frozen=True)
class RoutesSource:
    """Splines along the routes on the request's map with a bundle's finish: no network.

    Raises `BenchmarkError` unless the finish is a spline.
    """

    bundle: Bundle

    def __post_init__(self) -> None:
        spline_finish(self.bundle)

    def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        """Plan within the limits of the request and the card.

        Raises `InvalidRequest` if the request does not fit the card.
        """
        asked = resolve_for_card(request, self.bundle.card)
        scene = scene_of(asked)
        finish = spline_finish(self.bundle)
        finish = replace(finish, certified_margin=asked.certified_margin)
        planner = RoutesPlanner(scene.motion, finish, finish.steps)
        anchors = planner.plan(scene, num=asked.num_samples, seed=asked.seed)
        assert anchors.safe is not None  # the finish computes it
        arrays = {
            "trajectories": anchors.positions,
            "velocities": anchors.velocities,
            "accelerations": anchors.accelerations,
            "safe": anchors.safe,
        }
        return _batch("routes", arrays, dt=anchors.dt, seed=asked.seed, request=request)


class LossySource:
    """Loses some answers of another source."""

    def __init__(self, source: AnchorSource, *, share: float, seed: int) -> None:
        """share: of lost answers, in [0, 1]; seed: which are lost."""
        self._source, self._share = source, share
        self._rng = np.random.default_rng([seed, 2])

    def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        batch = self._source.plan_request(request)
        if self._rng.random() < self._share:
            raise ConnectionFailed(f"the answer to {request.request_id} was lost")
        return batch


def _batch(
    name: str,
    arrays: dict[str, NDArray],
    *,
    dt: float | NDArray[np.float64],
    seed: int,
    request: AnchorRequest,
) -> AnchorBatch:
    return AnchorBatch(
        arrays=arrays,
        dt=dt,
        seed=seed,
        model=ModelId(name, "1", ""),
        timing_ms={},
        request_id=request.request_id,
    )
