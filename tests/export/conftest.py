"""A planner that is not ours, and its bundle."""

from __future__ import annotations

from pathlib import Path

import pytest
from torch_camera_planner import DESCRIPTION, CameraConfig, CameraPlanner, camera_adapter

from anchorflow_export.adapter import ExportChoices, PlannerAdapter
from anchorflow_export.bundle import export_bundle


@pytest.fixture
def camera() -> PlannerAdapter:
    """The adapter of a planner that is not ours, and is traced in a second."""
    return camera_adapter(CameraPlanner(CameraConfig()), ExportChoices())


@pytest.fixture(scope="session")
def camera_bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its bundle."""
    out = tmp_path_factory.mktemp("camera") / "bundle"
    adapter = camera_adapter(CameraPlanner(CameraConfig()), ExportChoices())
    differences = export_bundle(adapter, DESCRIPTION, out=out)
    assert {part.what.split()[0] for part in differences} == {"encode", "score", "sample"}
    assert max(part.error for part in differences) <= 1e-5
    return out
