"""Rules and bundles are judged by what became of the others."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from driven_bend import write_bends

from anchorflow_benchmarks import BenchmarkError
from anchorflow_benchmarks.driving.futures import (
    futures_tables,
    judge_predictors,
    open_predictors,
)
from anchorflow_driving.futures import RULES
from anchorflow_driving.log import read_logs
from anchorflow_service.bundle import DEFAULT_BUNDLE

BUNDLES = DEFAULT_BUNDLE.parent


def test_rules_and_the_bundle_that_ships_are_judged_side_by_side(tmp_path: Path) -> None:
    logs = write_bends(tmp_path, count=1)
    predictors = open_predictors([BUNDLES / "goalflow"], threads=1)
    everybody, *_ = futures_tables(judge_predictors(predictors, read_logs(logs)))
    rows: dict[Any, Any] = {row["predictor"]: row for row in everybody.rows}
    assert [*rows] == [*RULES, "goalflow"]
    assert rows["constant_velocity"]["ratio"] == 1.0
    assert rows["constant_turn"]["minADE"] < 0.1
    assert rows["goalflow"]["minADE"] < 0.7 * rows["constant_velocity"]["minADE"]


def test_a_bundle_that_predicts_nothing_is_refused() -> None:
    with pytest.raises(BenchmarkError, match="wote: expected the extra futures"):
        open_predictors([BUNDLES / "wote"], threads=1)
