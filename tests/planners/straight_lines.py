"""An engine that needs no networks: its anchors are straight lines."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from anchorflow_client import (
    AnchorBatch,
    AnchorRequest,
    AnswerSpec,
    CostMapSpec,
    LimitsSpec,
    ModelCard,
    OdeSpec,
    RefineSpec,
    TensorSpec,
    TimeSpec,
)
from anchorflow_client.contract import ResolvedRequest

CARD = ModelCard(
    name="lines",
    version="1.2.3",
    sha256="ab" * 32,
    planner="lines",
    inputs=(TensorSpec("x_curr", "float32", ("B", 6), "m, m/s, m/s^2"),),
    conditioning=CostMapSpec(
        channels=3,
        H=64,
        W=64,
        limits=LimitsSpec(horizon_s=8.0, v_max=2.0, a_max=3.0, robot_radius=0.25),
        ranges={"robot_radius": (0.0, 5.0)},
    ),
    sampler=OdeSpec("rk4", (0.0, 0.5, 1.0)),
    finish=RefineSpec(smooth=True, project=True, safety_margin=0.05, guidance=0.0),
    time=TimeSpec(steps=16, first_s=0.0, dt=8.0 / 15),
    answer=AnswerSpec(("x", "y"), ("velocities", "accelerations", "scores", "clearance", "safe")),
)

FREE_CARD = replace(
    CARD,
    conditioning=replace(
        CARD.cost_map,
        limits=replace(CARD.cost_map.limits, horizon_s=None),
        ranges={"v_max": (0.1, 6.0), "horizon_s": (1.0, 60.0)},
    ),
    time=TimeSpec(steps=16, first_s=0.0, dt=None),
)
"""The card of a planner whose anchors have their own durations."""


def minimum_jerk(steps: int) -> np.ndarray:
    """Position, velocity and acceleration [3,steps] from rest at 0 to rest at 1 in unit time."""
    s = np.linspace(0, 1, steps)
    position = 10 * s**3 - 15 * s**4 + 6 * s**5
    return np.stack([position, 30 * (s - s**2) ** 2, 60 * s - 180 * s**2 + 120 * s**3])


class StraightLines:
    """An engine: minimum-jerk motion along straight lines, fanned out by a seeded draw.

    `before_answer` sees each request and what would be answered, and gives what is answered: here
    a test lets the engine block, fail or answer nonsense.
    """

    def __init__(self, card: ModelCard = CARD) -> None:
        self.card = card
        self.seen: list[AnchorRequest] = []
        self.before_answer: Callable[[AnchorBatch], AnchorBatch] = lambda batch: batch

    def plan(self, request: AnchorRequest, /, **_: Any) -> AnchorBatch:
        """[B,N,T,2], the B axis dropped where the request is not batched."""
        self.seen.append(request)
        profile = minimum_jerk(self.card.T)
        scenes = [self._scene(request, b, profile) for b in range(request.num_scenes)]
        arrays: dict[str, Any] = {
            name: np.stack([scene[name] for scene in scenes]) for name in scenes[0]
        }
        if not request.batched:
            arrays = {name: array[0] for name, array in arrays.items()}
        return self.before_answer(
            AnchorBatch(
                arrays=arrays,
                dt=_time_steps(request, arrays["scores"].shape, self.card.T),
                seed=request.seed or 0,
                model=self.card.id,
                timing_ms={"encode": 1.0, "sample": 2.0, "refine": 3.0, "total": 6.0},
            )
        )

    def _scene(self, request: AnchorRequest, scene: int, profile: np.ndarray) -> dict[str, Any]:
        start, goal = request.x_curr[scene, :2], request.x_goal[scene, :2]
        fan = (
            np.random.default_rng(request.seed).normal(size=(request.num_samples or 64, 1, 1))
            * 0.01
        )
        line = profile[:, None, :, None] * (goal - start) + fan * profile[:, None, :, None]
        line[0] += start
        names = ("trajectories", "velocities", "accelerations")
        per_anchor = np.abs(fan[:, 0, 0])
        return dict(zip(names, line, strict=True)) | {
            "scores": -per_anchor,
            "clearance": per_anchor,
            "safe": per_anchor < 1,
        }


class SteppingEngine:
    """Plans in three steps, which the test releases, and calls `check` after each."""

    def __init__(self, engine: StraightLines) -> None:
        self._engine, self.card = engine, engine.card
        self.at_work, self.steps = threading.Semaphore(0), threading.Semaphore(0)
        self.taken = 0
        self.left = threading.Event()

    def plan(
        self, request: AnchorRequest, /, *, threads: int, check: Callable[[], object]
    ) -> AnchorBatch:
        """Return the engine's answer after the steps, unless `check` ends the work."""
        self.at_work.release()
        try:
            for _ in range(3):
                assert self.steps.acquire(timeout=20)
                self.taken += 1
                check()
        finally:
            self.left.set()
        return self._engine.plan(request, threads=threads, check=check)

    def flow_states(self, request: ResolvedRequest, /) -> Any:
        """Stand for the states of a flow, which no test reaches."""
        raise AssertionError(request)


def _time_steps(request: AnchorRequest, anchors: tuple[int, ...], steps: int) -> Any:
    """The horizon's where there is one, else another for every anchor: 1 s, 1.1 s, 1.2 s …"""
    assert isinstance(request, ResolvedRequest)
    assert request.limits is not None
    horizon_s = request.limits.horizon_s
    if horizon_s is not None:
        return horizon_s / (steps - 1)
    return (1.0 + 0.1 * np.arange(np.prod(anchors)).reshape(anchors)) / (steps - 1)
