"""The stages of a truncated diffusion are timed, every step on its own."""

from __future__ import annotations

from pathlib import Path

import pytest
from diffusion_planner import write_diffusion_bundle
from image_planner import write_image_bundle

from anchorflow_benchmarks.diffusion_stages import ROLES, stage_table
from anchorflow_benchmarks.errors import BenchmarkError

CLOCKS = ("p50", "cpu")


def test_a_row_for_every_number_of_steps(tmp_path: Path) -> None:
    table = stage_table([write_diffusion_bundle(tmp_path)], rounds=3, threads=1)
    assert [row["steps"] for row in table.rows] == [1, 2, 4]
    for row in table.rows:
        assert (row["model"], row["candidates"]) == ("tiny-diffusion", 24)
        for name in ("total p50", *(f"{role} {clock}" for role in ROLES for clock in CLOCKS)):
            assert float(str(row[name])) > 0, name


def test_a_bundle_of_another_kind_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BenchmarkError, match="expected a truncated_diffusion, got 'vocabulary'"):
        stage_table([write_image_bundle(tmp_path)], rounds=3, threads=1)
