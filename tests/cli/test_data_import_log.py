"""`anchorflow data import-log`, on a street that is made here."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from command_line import failure, succeed

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


@pytest.fixture
def file(tmp_path: Path) -> Path:
    (tmp_path / "a.xml").write_text(SCENARIO)
    return tmp_path / "a.xml"


def refused(*arguments: object) -> str:
    return failure("data", "import-log", *arguments, "--out", "never.npz")


def test_a_scenario_is_imported(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    succeed("data", "import-log", file, "--out", file.with_suffix(".npz"))

    assert "1 tracks, 100 frames, 4 windows" in capsys.readouterr().out
    assert read_log(file.with_suffix(".npz")).window_frame.tolist() == [20, 30, 40, 50]


def test_a_scenario_that_lacks_something_is_one_line(file: Path) -> None:
    file.write_text(SCENARIO.replace("<width>2</width>", ""))
    place = "commonRoad.dynamicObstacle[2].shape.rectangle.width"
    assert f"a.xml: {place}: expected the element" in refused(file)


def test_a_pickle_is_opened_on_request_only(tmp_path: Path) -> None:
    file = tmp_path / "a.pkl"
    file.write_bytes(b"never read")

    assert "is a pickle: --unpickle opens it" in refused(file)
    assert "expected a pickle of plain data" in refused(file, "--unpickle")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--scene", "a"), "--scene: a recording of commonroad"),
        (("--unpickle",), "for navsim, found commonroad"),
        (("--map", "map.gpkg"), "for navsim, found commonroad"),
        (("--format", "nuscenes"), "one v1.0-* with scene.json"),
        (("--sensors", "."), "for nuscenes and navsim, found commonroad"),
        (("--as-recorded",), "--as-recorded: expected --sensors too, found none"),
    ],
)
def test_options_of_another_layout_are_refused(
    options: tuple[str, ...], said: str, file: Path
) -> None:
    assert said in refused(file, *options)


def test_argoverse_without_pyarrow_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    monkeypatch.delitem(sys.modules, "anchorflow_driving.importers.argoverse", raising=False)
    file = tmp_path / "scenario_a.parquet"
    file.touch()

    wanted = "needs pyarrow, which is not installed: pip install 'anchorflow[driving]'"
    assert wanted in refused(file)
