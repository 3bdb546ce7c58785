"""A good request and a card, from which the tests depart."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from anchorflow_client import (
    AnswerSpec,
    CostMapSpec,
    LimitsSpec,
    ModelCard,
    OdeSpec,
    RefineSpec,
    TensorSpec,
    TimeSpec,
)


@pytest.fixture
def fields() -> dict[str, Any]:
    """The JSON fields of a request over a free map of 16 x 20 cells, 0.5 m each."""
    return {
        "cost_map": {"data": np.zeros((1, 16, 20)).tolist(), "resolution": 0.5},
        "x_curr": [-3.0, 0.5, 0.0, 0.0, 0.0, 0.0],
        "x_goal": [3.0, 0.5, 0.0, 0.0],
    }


@pytest.fixture
def card() -> ModelCard:
    """A card that lets robot_radius change, and nothing else."""
    return ModelCard(
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
            adjustable=("robot_radius",),
        ),
        sampler=OdeSpec("rk4", (0.0, 0.5, 1.0)),
        finish=RefineSpec(smooth=True, project=True, safety_margin=0.05, guidance=0.0),
        time=TimeSpec(steps=64, first_s=0.0, dt=8.0 / 63),
        answer=AnswerSpec(("x", "y"), ("velocities", "scores", "safe")),
        quality={"any": 0.9},
    )
