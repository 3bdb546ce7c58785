"""No caller waits for a compiler: an engine that is ready has compiled all that requests need."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

from anchorflow_client import AnchorRequest
from anchorflow_service.local import LocalClient

REST = [0.0, 0.0]
START, GOAL = [-3.0, 0.1, 0.5, 0.0, *REST], [3.0, 0.2, *REST]
CROSSING = {"position": [[0.0, -3.0]], "velocity": [[0.0, 1.0]], "radius": [0.3]}
EVERYTHING = {"project": True, "barrier": True, "guidance": 0.5, "certified_margin": 0.05}


def variants() -> dict[str, int]:
    """How many types each of this project's loops is compiled for."""
    modules = [each for name, each in [*sys.modules.items()] if name.startswith("anchorflow_")]
    # Compare types: `isinstance` would load modules that are imported lazily.
    found = (each for module in modules for each in vars(module).values())
    found = (each for each in found if issubclass(type(each), Dispatcher))
    return {
        f"{each.py_func.__module__}.{each.py_func.__name__}": len(each.overloads) for each in found
    }


@pytest.mark.parametrize(
    "asked",
    [
        {},
        {"refine": EVERYTHING, "v_max": 1.1},
        {"refine": {"project": False}, "num_samples": 1},
        {"horizon_s": 11.0, "refine": {"project": True}},
        {"warm_start": {"trajectory": [START[:2], [0.0, 1.5], GOAL[:2]], "tau": 0.75}},
        {"obstacles": CROSSING, "horizon_s": 6.0},
        {"obstacles": CROSSING, "horizon_s": 1.2},  # on the way only
        {"obstacles": {"position": [GOAL[:2]], "velocity": [[0, 0]], "radius": [2.0]}},
    ],
    ids=str,
)
def test_a_request_compiles_nothing(free_bundle_built: Path, asked: dict[str, Any]) -> None:
    client = LocalClient.of(free_bundle_built, threads=2)
    data = np.zeros((3, 16, 16), np.float32)
    data[0, 7:9, 7:9], data[1], data[2, 9:] = 1.0, 1.0, 0.5
    before = variants()
    assert before
    fields = {"x_curr": START, "x_goal": GOAL, "num_samples": 12, "seed": 7} | asked
    client.plan_request(
        AnchorRequest.from_fields(fields | {"cost_map": {"data": data, "resolution": 0.5}})
    )
    assert variants() == before
