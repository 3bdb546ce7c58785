"""`anchorflow data anchors` clusters and scores; what it does is kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from driven_bend import write_bends

from anchorflow_cli.main import main


def test_anchors_are_written_and_scored(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs, out = write_bends(tmp_path, count=1), tmp_path / "made" / "anchors.npy"
    with pytest.raises(SystemExit) as ended:
        main(["data", "anchors", str(logs), "--out", str(out), "--count", "3"])
    assert ended.value.code in (0, None)
    assert np.load(out).shape == (3, 8, 3)
    assert "3 anchors of 3 windows" in capsys.readouterr().out
    (kept,) = logs.glob("*.pdm-*")
    assert np.load(kept)["scores"].shape == (3, 3, 5)


def test_a_folder_without_logs_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["data", "anchors", str(tmp_path), "--out", str(tmp_path / "a.npy")])
    assert "expected logs (*.npz)" in str(ended.value)
