"""A planner that is not ours, and its bundle."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from exported_bundles import export_once
from torch_camera_planner import DESCRIPTION, CameraConfig, CameraPlanner, camera_adapter

from anchorflow_export.adapter import ExportChoices, PlannerAdapter
from anchorflow_export.bundle import export_bundle
from anchorflow_export.quantization import quantize_bundle


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


@pytest.fixture(scope="session")
def flowmp_rounded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small FlowMP in eight bits: to read, not to change."""
    whole = tmp_path_factory.mktemp("rounded") / "bundle"
    shutil.copytree(export_once("flowmp").path, whole)
    assert 0.0 < quantize_bundle(whole).error < 1.0  # Random weights: the encoder's goes far.
    return whole
