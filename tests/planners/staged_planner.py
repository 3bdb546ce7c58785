"""Stages for the clients: an answer in JSON, and a planner whose answers the test controls."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import replace
from typing import Any

import numpy as np

from anchorflow_client import AnchorBatch, AnchorFlowError, AnchorRequest, ModelId
from anchorflow_client.contract.batch import ARRAY_DTYPES, MOTIONS
from anchorflow_client.planner import Planner, PlannerConfig
from anchorflow_client.planner.plan import Plan

VIEW: dict[str, Any] = {
    "cost_map": np.zeros((16, 16)),
    "resolution": 0.5,
    "x_curr": [0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
    "x_goal": [2.0, 0.0, 0.0, 0.0],
}
DT = 0.5
ANSWER: dict[str, Any] = {
    "trajectories": [[[0.0, 0.0], [1.0, 0.0]]],
    "velocities": [[[0.0, 0.0], [0.0, 0.0]]],
    "accelerations": [[[0.0, 0.0], [0.0, 0.0]]],
    "scores": [1.0],
    "clearance": [0.5],
    "safe": [True],
    "dt": 1.0,
    "seed": 3,
    "model": {"name": "lines", "version": "1", "sha256": "ab"},
    "timing_ms": {"total": 1.0},
    "request_id": "r1",
}


def made_batch(trajectories: Any = None, **fields: Any) -> AnchorBatch:
    """Return safe anchors; arrays that are not given by name have the shape of `trajectories`."""
    paths = np.zeros((3, 4, 2), np.float32) if trajectories is None else np.asarray(trajectories)
    per_anchor = np.zeros(paths.shape[:-2])
    values: dict[str, Any] = dict.fromkeys(MOTIONS, paths)
    values |= {"scores": per_anchor, "clearance": per_anchor + 1, "safe": per_anchor == 0}
    values |= {"dt": 0.1, "seed": 1, "model": ModelId("lines", "1", "ab")}
    values |= {"timing_ms": {"total": 1.0}} | fields
    arrays = {name: values.pop(name) for name in list(values) if name in ARRAY_DTYPES}
    return AnchorBatch(arrays=arrays, **values)


def batch_for(request: AnchorRequest) -> AnchorBatch:
    """Return two anchors of five steps along x, at 1 and at 2 m/s; the second is the best."""
    times, speeds = DT * np.arange(5), np.array([1.0, 2.0], np.float32)
    paths = np.zeros((2, 5, 2), np.float32)
    paths[..., 0] = speeds[:, None] * times
    velocities = np.zeros_like(paths)
    velocities[..., 0] = speeds[:, None]
    return made_batch(
        paths,
        velocities=velocities,
        accelerations=np.zeros_like(paths),
        scores=speeds,
        dt=DT,
        seed=0,
        request_id=request.request_id,
    )


def nothing_safe(request: AnchorRequest) -> AnchorBatch:
    """Return the same anchors, none of them safe."""
    batch = batch_for(request)
    return replace(batch, arrays={**batch.arrays, "safe": np.zeros(2, bool)})


class Stage:
    """A planner, its clock, and its pending requests, which the test answers."""

    def __init__(self, config: PlannerConfig) -> None:
        self.now = 100.0
        self.requests: list[AnchorRequest] = []
        self.waiting: list[Callable[[], None]] = []
        self.reply: Callable[[AnchorRequest], AnchorBatch] = batch_for
        self.planner = Planner(self, config, clock=lambda: self.now, executor=ByHand(self.waiting))

    def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        self.requests.append(request)
        return self.reply(request)

    def update(self, **view: Any) -> Plan:
        return self.planner.update(**VIEW | view)

    def answer(self, which: int = 0) -> None:
        """Let a request through, by default the oldest."""
        self.waiting.pop(which)()

    def fail(self, error: AnchorFlowError) -> None:
        """Let the oldest pending request fail."""
        self.reply = raising(error)
        self.answer()
        self.reply = batch_for

    def cycle(self, seconds: float = 0.1, **view: Any) -> Plan:
        """Send a request, answer it, and return the plan `seconds` after the observation."""
        self.update(**view)
        self.answer()
        self.now += seconds
        return self.planner.wait(0.0)


class ByHand(Executor):
    """Keeps the calls until the test runs them."""

    def __init__(self, waiting: list[Callable[[], None]]) -> None:
        self._waiting = waiting

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()

        def run() -> None:
            try:
                future.set_result(fn(*args, **kwargs))
            except AnchorFlowError as error:
                future.set_exception(error)

        self._waiting.append(run)
        return future


def raising(error: AnchorFlowError) -> Callable[[AnchorRequest], AnchorBatch]:
    def reply(_: AnchorRequest) -> AnchorBatch:
        raise error

    return reply
