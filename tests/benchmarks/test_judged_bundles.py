"""Which bundles the benchmarks open."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from image_planner import write_image_bundle

from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.judged_bundles import open_bundle
from anchorflow_benchmarks.planners import bundle_names
from anchorflow_service.bundle import DEFAULT_BUNDLE


def test_a_planner_of_cost_maps_is_opened() -> None:
    assert open_bundle(DEFAULT_BUNDLE).path == DEFAULT_BUNDLE


def test_a_planner_without_a_cost_map_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(BenchmarkError, match=r"tiny-camera: .*got conditioning 'tensors'.*judge"):
        open_bundle(write_image_bundle(tmp_path))


def test_bundles_are_told_apart_by_as_much_of_their_path_as_it_takes(tmp_path: Path) -> None:
    for folder in ("first/same", "second/same", "another"):
        shutil.copytree(DEFAULT_BUNDLE, tmp_path / folder)
    same, again, another = (
        open_bundle(tmp_path / folder) for folder in ("first/same", "second/same", "another")
    )
    assert bundle_names([same]) == ["flowmp-small"]
    assert bundle_names([same, another]) == ["flowmp-small (same)", "flowmp-small (another)"]
    assert bundle_names([same, again]) == [
        f"flowmp-small ({tmp_path}/first/same)",
        f"flowmp-small ({tmp_path}/second/same)",
    ]
