"""An engine that is asked as the service asks it, and what its answers are compared with."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from anchorflow_client.contract import AnchorBatch, AnchorRequest, resolve_for_card
from anchorflow_service.bundle import load_bundle
from anchorflow_service.engine import Engine
from anchorflow_service.engine.conditioning.cost_map import CostMapConditioning

Build = Callable[..., AnchorRequest]
AS_SAMPLED = {"smooth": False, "project": False}
FINISHED = {"smooth": True, "project": True}
ARRAYS = ("trajectories", "velocities", "accelerations", "scores", "clearance", "safe")


def plan(engine: Engine, request: AnchorRequest, **how: Any) -> AnchorBatch:
    """Plan a request, completed by the engine's card."""
    return engine.plan(resolve_for_card(request, engine.card), **how)


def assert_same_bytes(batch: AnchorBatch, other: AnchorBatch, *, scene: int | None = None) -> None:
    for name in (*ARRAYS, "durations"):
        array = getattr(other, name)
        array = array if scene is None else array[scene]
        assert getattr(batch, name).tobytes() == array.tobytes(), name


def walled() -> dict[str, Any]:
    """Return a cost map of 16 x 16 cells with a wall from one edge to the other."""
    occupancy = np.zeros((1, 16, 16), np.float32)
    occupancy[0, :, 7:9] = 1.0
    return {"data": occupancy, "resolution": 0.5}


def assert_same_at_once(engine: Engine, requests: Sequence[AnchorRequest]) -> None:
    """Plans of several threads at once have the bytes of plans one after the other."""
    alone = [plan(engine, request) for request in requests]
    with ThreadPoolExecutor(len(requests)) as pool:
        for one, other in zip(alone, pool.map(partial(plan, engine), requests), strict=True):
            assert_same_bytes(one, other)


def means_of(folder: Path, request: AnchorRequest, num_samples: int = 20) -> np.ndarray:
    """[N,T,S], the prior's mean of each anchor of a request's only scene."""
    bundle = load_bundle(folder)
    asked = resolve_for_card(request, bundle.card)
    (scene,) = CostMapConditioning(bundle.manifest).scenes(asked)
    routes = scene.scene.route_states
    return routes[np.arange(num_samples) % len(routes)]


def drawn(num_samples: int) -> np.ndarray:
    """Noise of seed 7, [N,3]."""
    generator = np.random.Generator(np.random.PCG64(7))
    return generator.standard_normal((num_samples, 3), dtype=np.float32)
