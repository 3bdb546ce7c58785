"""The program that docs/driving.md shows."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from anchorflow_docs.programs import programs_of
from anchorflow_driving.log import DrivingLog, write_log

PAGE = Path(__file__).parents[2] / "docs" / "driving.md"


def test_the_program_of_the_page_runs(
    street: Callable[..., DrivingLog],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    write_log(street(), tmp_path / "street.npz")
    monkeypatch.chdir(tmp_path)

    (program,) = programs_of(PAGE)
    exec(compile(program.text, program.place, "exec"), {})

    assert capsys.readouterr().out == "[1.]\n"
