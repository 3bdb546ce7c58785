"""Tables in three forms."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from anchorflow_benchmarks import BenchmarkError
from anchorflow_benchmarks.report import Cell, Report, ResultTable, formatted

TABLE = ResultTable(
    "Speed", [{"who": "a", "ms": 1.23456, "N": 3}, {"who": "b", "ms": float("nan"), "N": None}]
)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.97349, "0.973"),
        (12.34, "12.3"),
        (4321.9, "4322"),
        (-0.5, "-0.500"),
        (7, "7"),
        ("x", "x"),
        (None, "–"),
        (float("nan"), "–"),
    ],
)
def test_numbers_are_short(value: Cell, text: str) -> None:
    assert formatted(value) == text


def test_markdown_has_a_row_a_row_and_a_dash_for_what_it_lacks() -> None:
    table = ResultTable("Uneven", [*TABLE.rows, {"who": "c", "torch": 1.0}])
    assert table.to_markdown().splitlines()[2:] == [
        "| who | ms | N | torch |",
        "| --- | ---: | ---: | ---: |",
        "| a | 1.235 | 3 | – |",
        "| b | – | – | – |",
        "| c | – | – | 1.000 |",
    ]


def test_both_files_say_first_what_was_typed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = ["bench", "quality", "--bundle", "my bundles/a", "--samplers", "card,rk4:8step"]
    monkeypatch.setattr(sys, "argv", [".venv/bin/anchorflow", *options, "--out", "results"])
    report = Report("Speed", {"commit": "abc"}, [TABLE])
    of_json, of_markdown = report.write(tmp_path / "results")

    assert (of_json.name, of_markdown.name) == ("speed.json", "speed.md")
    command = "anchorflow bench quality --bundle 'my bundles/a' --samplers card,rk4:8step"
    read = json.loads(of_json.read_text())
    assert [*read["about"].items()] == [("command", command), ("commit", "abc")]
    assert read["tables"][0]["rows"][1] == {"who": "b", "ms": None, "N": None}
    assert of_markdown.read_text().splitlines()[2:4] == [f"- command: {command}", "- commit: abc"]


def test_names_are_no_markup(capsys: pytest.CaptureFixture[str]) -> None:
    name = "a[red]b[/c]:car:"
    table = ResultTable(f"of {name}", [{name: 1, "bundle": f"its {name}"}], f"beside {name}")
    Report("Names", {"file": name}, [table]).show()

    shown = capsys.readouterr().out
    for line in (f"of {name}", f"its {name}", f"beside {name}", f"file: {name}"):
        assert line in shown
    assert shown.count(name) == 5
    rows = ResultTable("Names", [{"who": "a|b", "ms": 1}]).to_markdown()
    assert rows.splitlines()[-1] == r"| a\|b | 1 |"


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(BenchmarkError, match="file"):
        Report("Speed", {}, [TABLE]).write(tmp_path / "file")
