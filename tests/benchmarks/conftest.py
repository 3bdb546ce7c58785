"""Small scenes, and the judge outside the project."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from types import ModuleType

import numpy as np
import pytest

from anchorflow_benchmarks.scene_files import STYLE
from anchorflow_training.scenes import FamilyScene
from anchorflow_trajectory.motion import MotionLimits


@pytest.fixture(scope="session")
def limits() -> MotionLimits:
    return MotionLimits(v_max=2.0, a_max=3.0)


@pytest.fixture
def scene(limits: MotionLimits) -> Callable[..., FamilyScene]:
    """Make a scene of 6.4 m from its occupied cells [H, W]: from (-2, 0) to (2, 0), at rest."""

    def make(occupied: np.ndarray, *, family: str = "blocks") -> FamilyScene:
        resolution = 6.4 / len(occupied)
        occupancy = occupied.astype(np.float32)
        return FamilyScene(
            family=family,
            cost_map=np.stack([occupancy, np.ones_like(occupancy), np.zeros_like(occupancy)]),
            resolution=resolution,
            origin=np.full(2, -3.2),
            robot_radius=0.25,
            x_curr=np.array([-2, 0, 0, 0, 0, 0], np.float32),
            x_goal=np.array([2, 0, 0, 0], np.float32),
            w_style=STYLE,
            motion=limits,
        )

    return make


@pytest.fixture(scope="session")
def shared_tool(request: pytest.FixtureRequest) -> Callable[[str], ModuleType]:
    """Import a program beside the checkout by its name, or skip the test if it is missing."""
    folder = request.config.rootpath.parent / "shared" / "tools"

    def load(name: str) -> ModuleType:
        if not (folder / f"{name}.py").exists():
            pytest.skip(f"the shared judge {name}.py is not in {folder}")
        with pytest.MonkeyPatch.context() as patch:
            patch.syspath_prepend(folder)
            return importlib.import_module(name)

    return load
