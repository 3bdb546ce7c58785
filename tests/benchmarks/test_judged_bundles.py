"""Which bundles the benchmarks open."""

from __future__ import annotations

from pathlib import Path

import pytest
from image_planner import write_image_bundle

from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.judged_bundles import open_bundle
from anchorflow_service.bundle import DEFAULT_BUNDLE


def test_a_planner_of_cost_maps_is_opened() -> None:
    assert open_bundle(DEFAULT_BUNDLE).path == DEFAULT_BUNDLE


def test_a_planner_without_a_cost_map_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(BenchmarkError, match=r"tiny-camera: .*got conditioning 'tensors'.*judge"):
        open_bundle(write_image_bundle(tmp_path))
