"""Who proposes anchors beside a client: straight lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from anchorflow_benchmarks.baselines import minimum_jerk
from anchorflow_client.contract import DEFAULT_NUM_SAMPLES, AnchorBatch, AnchorRequest, ModelId


@dataclass(frozen=True)
class LinesSource:
    """A straight line to the goal, and others that bend aside by smooth noise; blind to the map.

    spread: m, standard deviation of the first and widest of the bends
    """

    horizon_s: float = 8.0
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
        dt = self.horizon_s / (self.steps - 1)
        velocities = np.gradient(paths, dt, axis=1)
        return AnchorBatch(
            arrays={
                "trajectories": paths.astype(np.float32),
                "velocities": velocities,
                "accelerations": np.gradient(velocities, dt, axis=1),
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
