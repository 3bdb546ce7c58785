"""`anchorflow bench pairs` says which bundles it cannot judge."""

from __future__ import annotations

from pathlib import Path

import pytest

from anchorflow_cli.main import main
from anchorflow_service.bundle import DEFAULT_BUNDLE

V2X = DEFAULT_BUNDLE.parent / "v2x"


@pytest.mark.parametrize(
    ("bundles", "message"),
    [
        ([DEFAULT_BUNDLE], "expected a bundle asked with pictures, got cost_map"),
        ([V2X, V2X], "expected bundles of different names, got v2x"),
    ],
)
def test_what_it_cannot_judge(
    bundles: list[Path], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["bench", "pairs", *map(str, bundles)])
    assert ended.value.code == 2
    assert message in " ".join(capsys.readouterr().err.replace("│", " ").split())
