"""A recording's layout by its name and by what a folder holds."""

from __future__ import annotations

from pathlib import Path

import pytest

from anchorflow_driving.errors import LogError
from anchorflow_driving.importers import Layout, layout_of


@pytest.mark.parametrize(
    ("made", "asked", "layout"),
    [
        ("a.xml", "a.xml", Layout.COMMONROAD),
        ("A.XML", "A.XML", Layout.COMMONROAD),
        ("a.pkl", "a.pkl", Layout.NAVSIM),
        ("scenario_1.parquet", "scenario_1.parquet", Layout.ARGOVERSE),
        ("in/scenario_1.parquet", "in", Layout.ARGOVERSE),
        ("in/v1.0-mini/scene.json", "in", Layout.NUSCENES),
        ("in/v1.0-mini/scene.json", "in/v1.0-mini", Layout.NUSCENES),
    ],
)
def test_a_layout_is_known(tmp_path: Path, made: str, asked: str, layout: Layout) -> None:
    (tmp_path / made).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / made).touch()

    assert layout_of(tmp_path / asked) is layout


@pytest.mark.parametrize(
    ("made", "asked", "found"),
    [("a.csv", "a.csv", ".csv"), ("in/a.xml", "in", "none of them"), ("a.xml", "b.xml", "nothing")],
)
def test_what_is_none_is_refused(tmp_path: Path, made: str, asked: str, found: str) -> None:
    (tmp_path / made).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / made).touch()

    with pytest.raises(LogError, match=f"found {found}"):
        layout_of(tmp_path / asked)
