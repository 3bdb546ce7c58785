"""`anchorflow data import-log`, on a street that is made here."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from anchorflow_cli.main import main
from anchorflow_driving.log import read_log

POINTS = {
    side: "".join(f"<point><x>{x}</x><y>{y}</y></point>" for x in (0, 100, 200))
    for side, y in (("left", 2), ("right", -2))
}


def state(tag: str, step: int) -> str:
    return (
        f"<{tag}><position><point><x>{20 + step}</x><y>0</y></point></position>"
        f"<orientation><exact>0</exact></orientation><time><exact>{step}</exact></time>"
        f"<velocity><exact>10</exact></velocity></{tag}>"
    )


SCENARIO = (
    '<commonRoad commonRoadVersion="2020a" benchmarkID="A" timeStepSize="0.1"><lanelet id="1">'
    f"<leftBound>{POINTS['left']}</leftBound><rightBound>{POINTS['right']}</rightBound></lanelet>"
    '<dynamicObstacle id="2"><type>car</type><shape><rectangle><length>4</length><width>2</width>'
    f"</rectangle></shape>{state('initialState', 0)}<trajectory>"
    + "".join(state("state", step) for step in range(1, 100))
    + "</trajectory></dynamicObstacle></commonRoad>"
)


def test_a_scenario_is_imported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, out = tmp_path / "a.xml", tmp_path / "a.npz"
    file.write_text(SCENARIO)

    with pytest.raises(SystemExit) as ended:
        main(["data", "import-log", str(file), "--out", str(out)])

    assert not ended.value.code
    assert "1 tracks, 100 frames, 4 windows" in capsys.readouterr().out
    assert read_log(out).window_frame.tolist() == [20, 30, 40, 50]


def test_what_is_wrong_is_one_line(tmp_path: Path) -> None:
    file = tmp_path / "a.xml"
    file.write_text(SCENARIO.replace("<width>2</width>", ""))

    with pytest.raises(SystemExit) as ended:
        main(["data", "import-log", str(file), "--out", str(tmp_path / "a.npz")])

    told = str(ended.value.code)
    assert (
        "a.xml: commonRoad.dynamicObstacle[2].shape.rectangle.width: expected the element" in told
    )


def ends(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """What `import-log` says as it ends with an error."""
    with pytest.raises(SystemExit) as ended:
        main(["data", "import-log", *arguments, "--out", "never.npz"])
    assert ended.value.code
    told = capsys.readouterr().err + str(ended.value.code)
    return " ".join(told.replace("│", " ").split())


def test_a_pickle_is_opened_on_request_only(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "a.pkl"
    file.write_bytes(b"never read")

    assert "is a pickle: --unpickle opens it" in ends(capsys, str(file))
    assert "expected a pickle of plain data" in ends(capsys, str(file), "--unpickle")


def test_options_of_another_layout_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "a.xml"
    file.write_text(SCENARIO)

    assert "--scene: a recording of commonroad" in ends(capsys, str(file), "--scene", "a")
    assert "for navsim, found commonroad" in ends(capsys, str(file), "--unpickle")
    assert "for navsim, found commonroad" in ends(capsys, str(file), "--map", "map.gpkg")
    assert "one v1.0-* with scene.json" in ends(capsys, str(file), "--format", "nuscenes")


def test_argoverse_without_pyarrow_says_what_to_install(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    monkeypatch.delitem(sys.modules, "anchorflow_driving.importers.argoverse", raising=False)
    file = tmp_path / "scenario_a.parquet"
    file.touch()

    told = ends(capsys, str(file))

    assert "needs pyarrow, which is not installed: pip install 'anchorflow[driving]'" in told
