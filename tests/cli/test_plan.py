"""`anchorflow plan`: the request, the table and the picture of a command line."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from command_line import failure, succeed
from PIL import Image
from ros_maps import write_map

from anchorflow_client.contract import STYLES, AnchorBatch, AnchorRequest, GoalTolerance, ModelId
from anchorflow_service.local import LocalClient


@pytest.fixture
def map_file(tmp_path: Path) -> Path:
    """A free map of 20 × 20 m in a wall, its corner at (-10, -10)."""
    pixels = np.full((200, 200), 254, dtype=np.uint8)
    pixels[[0, -1]] = pixels[:, [0, -1]] = 0
    return write_map(tmp_path, pixels, (-10.0, -10.0))


@pytest.fixture
def requests(monkeypatch: pytest.MonkeyPatch) -> list[AnchorRequest]:
    """Collect the requests to an engine that answers with straight lines, the last unsafe."""
    received: list[AnchorRequest] = []

    def answer(request: AnchorRequest) -> AnchorBatch:
        received.append(request)
        return straight_lines(request)

    engine_answers(monkeypatch, answer)
    return received


def engine_answers(
    patch: pytest.MonkeyPatch, answer: Callable[[AnchorRequest], AnchorBatch]
) -> None:
    client = nullcontext(SimpleNamespace(plan_request=answer))
    patch.setattr(LocalClient, "of", lambda _: client)


def straight_lines(request: AnchorRequest) -> AnchorBatch:
    N = request.num_samples or 64
    times = np.linspace(0, 1, 64)[:, None]
    start, goal = request.x_curr[0, :2], request.x_goal[0, :2]
    bend = np.linspace(-1, 1, N)[:, None, None] * np.sin(np.pi * times)
    lines = (start + times * (goal - start) + bend).astype(np.float32)
    return AnchorBatch(
        arrays={
            "trajectories": lines,
            "velocities": np.zeros_like(lines),
            "accelerations": np.zeros_like(lines),
            "scores": np.linspace(-3, -1, N, dtype=np.float32),
            "clearance": np.full(N, 0.5, dtype=np.float32),
            "safe": np.arange(N) < N - 1,
        },
        # 2 s, and 0.1 s more for each anchor.
        dt=(2.0 + 0.1 * np.arange(N)) / 63,
        seed=7,
        model=ModelId("straight", "1.0.0", "0" * 64),
        timing_ms={"total": 12.0},
    )


def test_the_options_become_the_request(map_file: Path, requests: list[AnchorRequest]) -> None:
    ends = ("--start", "-2,1.5", "--start-velocity", "0.5,0", "--goal", "3,-1")
    choices = ("--style", "2,1,1", "--num-samples", 5, "--seed", 7, "--window", 10)
    limits = ("--v-max", 0.5, "--a-max", 2.5, "--robot-radius", 0.3, "--horizon", 12)
    succeed("plan", "--map", map_file, *ends, *choices, *limits)
    turned = ("--start", "-2,1,0.5", "--goal", "3,-1,0.2", "--goal-velocity", "1,0,0.1")
    allowed = ("--cost-penalty", 4, "--clear-start", "--goal-tolerance", 0.5)
    succeed("plan", "--map", map_file, *turned, "--style", "efficient", *allowed)

    whole, heading = requests
    np.testing.assert_array_equal(whole.x_curr, [[-2, 1.5, 0.5, 0, 0, 0]])
    np.testing.assert_array_equal(whole.x_goal, [[3, -1, 0, 0]])
    np.testing.assert_allclose(whole.w_style, [[0.5, 0.25, 0.25]])
    assert (whole.num_samples, whole.seed) == (5, 7)
    assert (whole.v_max, whole.a_max, whole.robot_radius, whole.horizon_s) == (0.5, 2.5, 0.3, 12)
    assert whole.cost_map.data.shape == (1, 1, 100, 100)
    assert not whole.batched
    assert (whole.cost_penalty, whole.clear_start, whole.goal_tolerance) == (None, False, None)
    assert (heading.cost_penalty, heading.clear_start) == (4, True)
    assert heading.goal_tolerance == GoalTolerance(0.5)
    np.testing.assert_array_equal(heading.x_curr, [[-2, 1, 0.5, 0, 0, 0, 0, 0, 0]])
    np.testing.assert_array_equal(heading.x_goal, [[3, -1, 0.2, 1, 0, 0.1]])
    np.testing.assert_allclose(heading.w_style, [STYLES["efficient"]])
    assert heading.cost_map.data.shape[-1] > 100  # the window covers x and y
    assert (heading.num_samples, heading.seed, heading.robot_radius) == (64, None, None)


def grey(path: Path, pixels: np.ndarray) -> Path:
    Image.fromarray(pixels).save(path)
    return path


def test_layers_are_pictures_of_the_maps_size(
    map_file: Path, tmp_path: Path, requests: list[AnchorRequest]
) -> None:
    pixels = np.zeros((200, 200), np.uint8)
    pixels[0] = 255  # the row with the largest y
    risk = grey(tmp_path / "risk.png", pixels)
    noise = grey(tmp_path / "noise.png", np.full((200, 200), 51, np.uint8))

    ends = ("--start=0,5", "--goal=0,9", "--window", 8)
    layers = ("--layer", f"risk={risk}", "--layer", f"4={noise}", "--cost-penalty", 7)
    succeed("plan", "--map", map_file, *ends, *layers)

    (request,) = requests
    _, traversability, risky, between, noisy = request.cost_map.data[0]
    assert (traversability == 1.0).all()
    assert not between.any()
    assert np.flatnonzero(risky.any(1)).tolist() == [69]
    np.testing.assert_allclose(noisy[0, 0], 0.2)
    assert noisy[-1].max() == 0.0  # beyond the map
    assert request.cost_penalty == 7


@pytest.mark.parametrize(
    ("layer", "words"),
    [
        ("risk", "expected traversability, risk or a channel up to 15, =, and a file, got 'risk'"),
        ("16={}", "got '16="),
        ("risk={}", "expected 200 x 200 pixels, as the map has, got 4 x 3"),
        ("risk={}.no", "expected a .pgm or .png picture"),
    ],
)
def test_a_layer_that_cannot_be_read_is_one_line(
    map_file: Path, tmp_path: Path, layer: str, words: str
) -> None:
    small = grey(tmp_path / "small.png", np.zeros((3, 4), np.uint8))
    ends = ("--start=0,0", "--goal=3,0")
    said = failure("plan", "--map", map_file, *ends, "--layer", layer.format(small))
    assert words in " ".join(said.split())


def test_an_end_off_the_map_and_a_lone_heading_are_said(map_file: Path) -> None:
    asked = ("plan", "--map", map_file, "--start=0,0")
    off = " ".join(failure(*asked, "--goal=300,0").split())
    assert "goal: expected a place on the map" in off
    lone = " ".join(failure(*asked, "--goal=3,0,1.5").split())
    assert "expected a heading in both" in lone


def test_a_map_too_large_for_a_request_gets_wider_cells(
    tmp_path: Path, requests: list[AnchorRequest], capsys: pytest.CaptureFixture[str]
) -> None:
    large = write_map(tmp_path, np.full((900, 900), 254, np.uint8), (0.0, 0.0))
    succeed("plan", "--map", large, "--start=2,2", "--goal=83,83")

    (request,) = requests
    assert request.cost_map.resolution == pytest.approx(0.3)
    assert request.cost_map.data.shape[-1] <= 512
    assert "cells of 0.3 m a side are planned on" in " ".join(capsys.readouterr().err.split())


PEOPLE = {"position": [[1, -1]], "velocity": [[0, 0.5]], "radius": [0.3], "growth": 0.1}


@pytest.fixture
def tracks(tmp_path: Path) -> Callable[[str], Path]:
    """Return a function that writes a file of tracks."""

    def write(text: str) -> Path:
        (tmp_path / "tracks.json").write_text(text)
        return tmp_path / "tracks.json"

    return write


@pytest.mark.parametrize(
    "moves", [{}, {"velocity": None, "forecast": [[[1, 0], [1, 2]]], "forecast_dt": 1.5}]
)
def test_obstacles_are_sent_and_drawn_by_time(
    map_file: Path, requests: list[AnchorRequest], tracks: Callable[[str], Path], moves: dict
) -> None:
    file = tracks(json.dumps(PEOPLE | moves))
    picture = file.with_name("plot.png")
    few = ("--num-samples", 5, "--out", picture)
    succeed("plan", "--map", map_file, "--start=0,0", "--goal=3,0", "--obstacles", file, *few)

    (request,) = requests
    assert request.obstacles is not None
    np.testing.assert_array_equal(request.obstacles.position, [[1, -1]])
    assert request.obstacles.growth == 0.1
    assert request.obstacles.forecast_dt == moves.get("forecast_dt")
    with Image.open(picture) as image:
        pixels = np.asarray(image.convert("RGB")).reshape(-1, 3).astype(int)
    for colour in ((68, 1, 84), (253, 231, 37)):  # viridis from its first to its last shade
        assert (np.abs(pixels - colour).max(1) < 30).sum() > 50


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "No such file or directory"),
        ("{", "expected JSON, got Expecting property name"),
        ("[1]", "obstacles"),
        (json.dumps(PEOPLE | {"velocity": None}), "obstacles.velocity: this field is required"),
        (json.dumps(PEOPLE | {"radius": [1, 2]}), "obstacles.radius: expected M = 1"),
        (json.dumps(PEOPLE | {"speed": 1}), "speed"),
    ],
)
def test_tracks_that_cannot_be_read_are_one_line(
    map_file: Path, tracks: Callable[[str], Path], text: str | None, words: str
) -> None:
    file = tracks("") if text is None else tracks(text)
    if text is None:
        file.unlink()
    ends = ("--start=0,0", "--goal=3,0")
    said = " ".join(failure("plan", "--map", map_file, *ends, "--obstacles", file).split())
    assert "--obstacles" in said
    assert "tracks.json" in said
    assert words in said


@pytest.mark.parametrize("style", ["hasty", "1,2", "1,2,nan"])
def test_an_unknown_style_names_the_four(style: str, map_file: Path) -> None:
    said = failure("plan", "--map", map_file, "--start=0,0", "--goal=3,0", "--style", style)
    for name in ("conservative", "balanced", "efficient", "comfortable", style):
        assert name in said


@pytest.mark.usefixtures("requests")
def test_the_table_and_the_picture(
    map_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    picture = tmp_path / "new" / "folder" / "plot.png"
    succeed(
        "plan",
        "--map",
        map_file,
        "--start",
        "0,0",
        "--goal",
        "3,0",
        "--num-samples",
        9,
        "--out",
        picture,
    )

    printed = capsys.readouterr().out
    assert "8 of 9 anchors are safe" in printed
    assert duration_row(printed) == ["2.70", "2.00", "2.40", "2.80"]  # best, least, median, most
    assert "straight 1.0.0, seed 7" in printed
    with Image.open(picture) as image:
        assert image.size == (1200, 1050)
        assert len(set(image.convert("RGB").get_flattened_data())) > 100


def duration_row(printed: str) -> list[str]:
    """Return the figures in the table's row of durations."""
    (line,) = [line for line in printed.splitlines() if "duration (s)" in line]
    return re.findall(r"\d+\.\d+", line)


@pytest.mark.parametrize("name", ["plot.bmp", "plot", "plot.png.pdf"])
def test_another_format_than_the_help_names_is_refused_before_planning(
    map_file: Path, requests: list[AnchorRequest], capsys: pytest.CaptureFixture[str], name: str
) -> None:
    said = failure("plan", "--map", map_file, "--start=0,0", "--goal=3,0", "--out", name)

    assert f"expected a file .png or .svg, got '{name}'" in said
    assert not requests
    succeed("plan", "--help")
    assert "Picture to draw, .png or .svg." in " ".join(capsys.readouterr().out.split())


@pytest.mark.usefixtures("requests")
def test_a_picture_that_cannot_be_written_is_one_line(map_file: Path, tmp_path: Path) -> None:
    picture = tmp_path / "plot.png"
    picture.symlink_to("/dev/full")
    said = failure("plan", "--map", map_file, "--start=0,0", "--goal=3,0", "--out", picture)
    assert said.startswith(f"anchorflow plan: {picture}: ")


def test_brackets_in_a_model_s_name_are_no_markup(
    map_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    named = ModelId("x[red]y[/z]", "1", "0" * 64)
    engine_answers(monkeypatch, lambda request: replace(straight_lines(request), model=named))
    succeed("plan", "--map", map_file, "--start", "0,0", "--goal", "3,0", "--num-samples", 2)
    assert "x[red]y[/z] 1, seed 7" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--start=-9.95,0", "--goal=-5,0"), "anchorflow plan: x_curr: expected a cell"),
        (("--url=http://127.0.0.1:1",), "127.0.0.1:1"),
    ],
)
def test_a_plan_that_cannot_be_made_is_one_line(
    options: tuple[str, ...], said: str, map_file: Path
) -> None:
    assert said in failure("plan", "--map", map_file, "--start=0,0", "--goal=3,0", *options)
