"""`anchorflow data`: import, inspect, from-poses, as a person runs them."""

from __future__ import annotations

import json
import pickle
import sys
from pathlib import Path

import numpy as np
import pytest
from command_line import failure, succeed

from anchorflow_training.data import SyntheticTrajectoryDataset
from anchorflow_training.data.scene_import import import_scenes
from anchorflow_training.dataset import open_dataset


def made(*arguments: object) -> None:
    succeed("data", *arguments)


def refused(*arguments: object) -> str:
    return failure("data", *arguments)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """8 trajectories; row 3 is not finite."""
    positions = SyntheticTrajectoryDataset("bezier", 8).read(slice(None))["positions"]
    positions[3, 5] = np.nan
    np.savez(tmp_path / "my.npz", positions=positions)
    return tmp_path / "my.npz"


def test_synthetic_trajectories_are_a_file_to_import(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    file = tmp_path / "toy.npz"
    made("synthetic", file, "--kind", "sine", "--count", 6, "--num-steps", 20, "--seed", 3)
    assert "6 trajectories, T 20, D 2" in capsys.readouterr().out
    drawn = SyntheticTrajectoryDataset("sine", 6, num_steps=20, seed=3).read(slice(None))
    np.testing.assert_array_equal(np.load(file)["positions"], drawn["positions"])
    made("import", file, tmp_path / "d")
    assert "6 scenes, T 20, D 2" in capsys.readouterr().out
    assert "kind: expected one of bezier, polynomial, sine, got 'zigzag'" in refused(
        "synthetic", tmp_path / "other.npz", "--kind", "zigzag"
    )


def test_import_and_inspect(file: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    out = tmp_path / "d"
    made("import", file, out, "--horizon-s", 8, "--a-max", 3, "--robot-radius", 0.4)
    said = capsys.readouterr().out
    assert "7 scenes, T 64, D 2" in said
    assert "a_max 3 m/s^2, horizon 8 s" in said
    assert "left out: not finite 1" in said
    assert "rows that are not finite: 3" in said
    scenes = open_dataset(out)
    assert scenes.limits.a_max == 3
    assert scenes.meta["robot_radius"] == 0.4

    made("inspect", out, "--out", tmp_path / "sheet.png")
    said = capsys.readouterr().out
    assert "7 scenes, M 1, T 64, D 2" in said
    assert "a_max 3 m/s^2, horizon 8 s" in said
    assert "durations 8 s; scenes with a given horizon 100%" in said
    assert "7 x 1 x 64 x 6" in said
    assert "family my: 7" in said
    assert "homology classes 1: 7 scenes" in said
    assert (tmp_path / "sheet.png").stat().st_size > 10_000


def test_durations_of_their_own_are_told(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    positions = SyntheticTrajectoryDataset("bezier", 4).read(slice(None))["positions"]
    np.savez(tmp_path / "my.npz", positions=positions, horizon_s=[5.0, 6.0, 7.0, 8.0])
    made("inspect", tmp_path / "my.npz")
    assert "duration 5 to 8 s" in capsys.readouterr().out
    made("import", tmp_path / "my.npz", tmp_path / "d")
    said = capsys.readouterr().out
    assert "horizon open" in said
    assert "ranges: horizon_s 5 to 8 s" in said
    made("inspect", tmp_path / "d")
    said = capsys.readouterr().out
    assert "ranges: horizon_s 5 to 8 s" in said
    assert "durations 5 to 8 s; scenes with a given horizon 50%" in said


def test_drawn_scenes_tell_their_robots(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    made("make", tmp_path / "d", "--scenes", 1, "--workers", 1)
    said = " ".join(capsys.readouterr().out.split())
    assert "v_max 2 m/s, a_max 3 m/s^2, horizon open" in said
    assert "ranges: robot_radius 0.1 to 0.6 m, v_max 0.2 to 6 m/s" in said
    scenes = open_dataset(tmp_path / "d")
    assert scenes.arrays["states"].shape == (1, 24, 64, 6)
    assert scenes.arrays["starts"].shape[:2] == (1, 24)


def test_inspect_a_file(file: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    made("inspect", file, "--out", tmp_path / "sheet.svg")
    said = capsys.readouterr().out
    assert "derivatives are per step" in said
    assert "7 of 8 samples, T 64, D 2" in said
    assert "left out, not finite: 1 rows: 3" in said
    assert (tmp_path / "sheet.svg").read_text().count("row ") == 7


def test_errors_are_one_line(file: Path, tmp_path: Path) -> None:
    assert "my.npz: dt: expected" in refused("import", file, tmp_path / "d")
    assert "dataset.json" in refused("inspect", tmp_path)
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(np.ones((2, 9, 2)).cumsum(1)))
    assert "--allow-pickle" in refused("import", tmp_path / "a.pkl", tmp_path / "d", "--dt", 1)
    made("import", tmp_path / "a.pkl", tmp_path / "d", "--dt", 1, "--allow-pickle")
    sheet = tmp_path / "new" / "sheet.svg"
    made("inspect", tmp_path / "d", "--out", sheet)
    sheet.unlink()
    sheet.symlink_to("/dev/full")
    assert "sheet.svg" in refused("inspect", tmp_path / "d", "--out", sheet)
    assert "expected a file .png" in refused("inspect", tmp_path / "d", "--out", "sheet.txt")
    assert "expected KITTI" in refused("from-poses", tmp_path / "none", tmp_path / "p.npz")


@pytest.mark.parametrize(
    ("info", "said"),
    [
        ({"x": 1}, "expected a list of objects"),
        ([1], "expected a list of objects"),
        ([{"image_path": "0.png", "batch_id": 1, "image_timestamp": "noon"}], "found 'noon'"),
    ],
)
def test_a_wrong_index_of_poses_is_named(info: object, said: str, tmp_path: Path) -> None:
    folder = tmp_path / "v" / "novatel_to_world"
    folder.mkdir(parents=True)
    (folder / "0.json").write_text("[]")
    (tmp_path / "data_info.json").write_text(json.dumps(info))
    answer = refused("from-poses", tmp_path, tmp_path / "p.npz")
    assert "data_info.json: expected" in answer
    assert said in answer
    (tmp_path / "data_info.json").unlink()
    assert "0.json: expected an object" in refused("from-poses", tmp_path, tmp_path / "p.npz")


def test_a_rate_beyond_measure_is_refused(tmp_path: Path) -> None:
    (tmp_path / "00.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 60)
    words = ("from-poses", tmp_path, tmp_path / "p.npz", "--rate-hz")
    assert "rate_hz: expected above 0 and at most 1000 Hz" in refused(*words, 1e9)


def test_drawing_names_its_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import_scenes(SyntheticTrajectoryDataset("sine", 1, num_steps=16), tmp_path / "d")
    monkeypatch.setitem(sys.modules, "matplotlib.axes", None)
    for name in ("scene_sheet", "plots"):
        monkeypatch.delitem(sys.modules, f"anchorflow_cli.{name}", raising=False)
    assert refused("inspect", tmp_path / "d", "--out", "sheet.png") == (
        "anchorflow data inspect --out needs matplotlib.axes, which is not installed: "
        "pip install 'anchorflow[plot]', in a checkout pip install -e '.[plot]'"
    )


def test_from_poses(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    lines = [f"1 0 0 0 0 1 0 0 0 0 1 {0.5 * i}" for i in range(40)]
    (tmp_path / "00.txt").write_text("\n".join(lines))
    out = tmp_path / "new" / "p.npz"
    made("from-poses", tmp_path, out, "--steps", 16, "--stride", 8, "--heading")
    assert "4 trajectories, T 16, D 3, dt 0.1 s, of 1 drives with 40 poses" in (
        capsys.readouterr().out
    )
    with np.load(out) as saved:
        np.testing.assert_allclose(saved["positions"][2, :, 0], 0.5 * np.arange(16), atol=1e-6)
        np.testing.assert_allclose(saved["velocities"][..., 0], 5.0, atol=1e-4)
    made("import", out, tmp_path / "d")
    assert "T 16, D 3" in capsys.readouterr().out


def test_brackets_in_names_are_no_markup(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "x[red]y[/z]"
    made("make", out, "--scenes", 1, "--trajectories", 4, "--workers", 1)
    assert f"{out}: 1 scenes; " in capsys.readouterr().out
    with np.load(file) as arrays:
        np.savez(tmp_path / "named.npz", **arrays, **{"a[/z]": np.arange(8)})  # type: ignore[arg-type]
    made("inspect", tmp_path / "named.npz", "--dt", 1)
    assert "a[/z]" in capsys.readouterr().out


@pytest.mark.parametrize("command", [["data", "inspect"], ["train"]])
def test_pairs_of_pictures_are_no_scenes(command: list[str], tmp_path: Path) -> None:
    (tmp_path / "dataset.json").write_text('{"format": "v2x pairs 1"}')
    assert "found pairs of pictures, of which --planner v2x_vlm learns" in failure(
        *command, tmp_path
    )
