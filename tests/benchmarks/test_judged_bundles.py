"""Which bundles the benchmarks open."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from anchorflow_benchmarks import judged_bundles
from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.judged_bundles import open_bundle
from anchorflow_service.bundle import DEFAULT_BUNDLE


def test_a_planner_of_cost_maps_is_opened() -> None:
    assert open_bundle(DEFAULT_BUNDLE).path == DEFAULT_BUNDLE


def test_a_planner_without_a_cost_map_is_refused_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    inputs = [SimpleNamespace(name=name) for name in ("camera", "ego_status")]
    bundle = SimpleNamespace(card=SimpleNamespace(name="driver", inputs=inputs))
    monkeypatch.setattr(judged_bundles, "load_bundle", lambda _: bundle)

    with pytest.raises(BenchmarkError, match=r"driver.*got inputs camera, ego_status.*judge"):
        open_bundle(Path("anywhere"))
