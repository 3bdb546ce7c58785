"""The example runs from end to end, at a size that teaches nothing."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest
from PIL import Image

from anchorflow_training.checkpoint import load_checkpoint

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "quickstart.py"


@pytest.fixture
def quickstart() -> ModuleType:
    spec = importlib.util.spec_from_file_location("quickstart", EXAMPLE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_it_trains_generates_and_draws(
    quickstart: ModuleType,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(quickstart.os, "cpu_count", lambda: 1)  # No processes beside it.
    quickstart.main(["--out", str(tmp_path), "--scenes", "8", "--steps", "2"])
    assert load_checkpoint(tmp_path / "run" / "checkpoint.pt").step == 2
    printed = capsys.readouterr().out
    for row in ("untrained", "trained", "finished"):
        assert f"{row}: " in printed
    with Image.open(tmp_path / "quickstart.png") as image:
        assert image.size == (1200, 930)


@pytest.mark.parametrize(
    ("option", "given", "wanted"),
    [
        ("--scenes", "0", "expected a whole number of at least 8, got '0'"),
        ("--scenes", "2", "expected a whole number of at least 8, got '2'"),
        ("--seed", "-1", "expected a whole number of at least 0, got '-1'"),
        ("--out", __file__, f"expected a folder to write, got {__file__}"),
    ],
)
def test_an_option_out_of_its_range_is_one_line(
    quickstart: ModuleType,
    option: str,
    given: str,
    wanted: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit, match="2"):
        quickstart.main([f"{option}={given}"])
    assert f"argument {option}: {wanted}" in capsys.readouterr().err
