"""The programs that docs/driving.md and docs/goalflow.md show."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from anchorflow_docs.page_blocks import programs_of
from anchorflow_driving.log import DrivingLog, write_log

DOCS = Path(__file__).parents[2] / "docs"


def test_the_program_of_the_page_runs(
    street: Callable[..., DrivingLog],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    write_log(street(), tmp_path / "street.npz")
    monkeypatch.chdir(tmp_path)

    (program,) = programs_of(DOCS / "driving.md")
    exec(compile(program.text, program.place, "exec"), {})

    assert capsys.readouterr().out == "[1.]\n"


def test_the_bundle_that_ships_drives_the_street(
    street: Callable[..., DrivingLog], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_log(street(), tmp_path / "street.npz")
    monkeypatch.chdir(tmp_path)

    (program,) = programs_of(DOCS / "goalflow.md")
    known: dict[str, Any] = {}
    exec(compile(program.text, program.place, "exec"), known)

    # The ego drives at 10 m/s on an empty street of two lanes and stays on it.
    plan = known["plan"]
    assert 30.0 < plan[-1, 0] < 60.0
    assert (np.abs(plan[:, 1]) < 4.0).all()
