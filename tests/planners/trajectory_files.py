"""Trajectory files made for tests."""

from pathlib import Path
from typing import Any

import numpy as np

RNG = np.random.default_rng(0)
COUNT, STEPS = 12, 9


def parabolas(dim: int = 2) -> np.ndarray:
    """[N, T, D] with constant accelerations, 0.1 s apart."""
    t = (np.arange(STEPS) * 0.1)[:, None]
    start, speed, acceleration = RNG.normal(size=(3, COUNT, 1, dim))
    return start + speed * t + 0.5 * acceleration * t**2


def l2_arrays(**changed: Any) -> dict[str, Any]:
    """Return every field of a file; arguments replace some."""
    return {
        "positions": parabolas(),
        "dt": 0.1,
        "cost_maps": RNG.uniform(size=(COUNT, 2, 16, 20)),
        "start_states": RNG.normal(size=(COUNT, 6)),
        "goal_states": RNG.normal(size=(COUNT, 4)),
        "style_weights": RNG.uniform(0.1, 1.0, (COUNT, 3)),
        "safety_margins": RNG.uniform(size=COUNT),
        "quality": RNG.uniform(size=COUNT),
        "resolution": 0.5,
    } | changed


def saved(path: Path, **arrays: Any) -> Path:
    np.savez(path, **arrays)
    return path
