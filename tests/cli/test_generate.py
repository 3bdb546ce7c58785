"""`anchorflow generate`: from a checkpoint to arrays, a table and a picture."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import failure, succeed
from flowmp_scenes import make_model
from PIL import Image
from ros_maps import write_map

from anchorflow_cli.generate import EMPTY_MAP_CELLS, empty_map
from anchorflow_models.generation import GeneratorConfig, TrajectoryGenerator
from anchorflow_training.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from anchorflow_training.trainer import TrainerConfig

ENDS = ("--start", "-1,0.5", "--goal", "2,-0.25")
QUICK = ("--num-samples", "3", "--steps", "2", "--seed", "5")


@pytest.fixture(scope="module")
def make_checkpoint(tmp_path_factory: pytest.TempPathFactory) -> Callable[[int], Path]:
    """Writes the checkpoint of an untrained model of D dimensions."""

    def make(dim: int) -> Path:
        model = make_model(num_steps=24, num_control_points=12, dim=dim)
        config, weights = model.config, model.state_dict()
        path = tmp_path_factory.mktemp("run") / "checkpoint.pt"
        settings = asdict(TrainerConfig(model=config))
        save_checkpoint(path, Checkpoint(7, settings, {}, weights, weights, {}, []))
        return path

    return make


@pytest.fixture(scope="module")
def checkpoint(make_checkpoint: Callable[[int], Path]) -> Path:
    return make_checkpoint(2)


@pytest.fixture
def room(tmp_path: Path) -> Path:
    """A map of 8 x 8 m round (0, 0): a block between the ends, unknown cells along the top."""
    pixels = np.full((80, 80), 254, np.uint8)
    pixels[30:50, 38:42] = 0
    pixels[:10] = 205
    return write_map(tmp_path, pixels, (-4.0, -4.0))


def run(checkpoint: Path, *arguments: object, quick: tuple[str, ...] = QUICK) -> None:
    succeed("generate", "--checkpoint", checkpoint, *ENDS, *quick, *arguments)


def drawn(
    checkpoint: Path, tmp_path: Path, *arguments: object, quick: tuple[str, ...] = QUICK
) -> dict[str, np.ndarray]:
    run(checkpoint, "--out", tmp_path / "new" / "anchors.npz", *arguments, quick=quick)
    with np.load(tmp_path / "new" / "anchors.npz") as arrays:
        return dict(arrays)


def test_the_arrays_the_table_and_the_picture(
    checkpoint: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arrays = drawn(checkpoint, tmp_path, "--plot", tmp_path / "anchors.png")
    printed = capsys.readouterr().out
    assert "of 3 anchors are safe" in printed
    assert "of step 7, seed 5" in printed
    assert arrays["trajectories"].shape == arrays["accelerations"].shape == (3, 24, 2)
    assert arrays["safe"].shape == arrays["clearance"].shape == (3,)
    assert arrays["dt"].shape == (3,)
    assert len(set(arrays["dt"])) == 3  # each anchor has its own
    np.testing.assert_allclose(arrays["trajectories"][:, 0], [[-1, 0.5]] * 3, atol=1e-5)
    np.testing.assert_allclose(arrays["trajectories"][:, -1], [[2, -0.25]] * 3, atol=1e-5)
    with Image.open(tmp_path / "anchors.png") as image:
        assert image.size == (1200, 1050)


@pytest.mark.parametrize(
    "option",
    [
        ("--start-velocity", "0.5,0"),
        ("--goal-velocity", "0.5,0"),
        ("--style", "0,1,0"),
        ("--size", "5"),
        ("--robot-radius", "0.9"),
        ("--v-max", "0.7"),
        ("--a-max", "0.5"),
        ("--horizon", "11"),
        ("--num-samples", "4"),
        ("--seed", "6"),
        ("--method", "euler"),
        ("--schedule", "8step"),
        ("--schedule", "0,0.9,1"),
        ("--steps", "3"),
        ("--no-project",),
        ("--safety-margin", "1.5"),
        ("--barrier-rate", "5", "--no-project"),
    ],
)
def test_every_option_is_heeded(
    checkpoint: Path, room: Path, tmp_path: Path, option: tuple[str, ...]
) -> None:
    further = option[2:]
    plain = drawn(checkpoint, tmp_path, "--map", room, *further)
    other = drawn(checkpoint, tmp_path, "--map", room, *option)
    assert any(not np.array_equal(plain[n], other[n]) for n in ("trajectories", "clearance"))


def test_a_horizon_is_every_anchor_s_and_limits_are_kept(checkpoint: Path, tmp_path: Path) -> None:
    fixed = drawn(checkpoint, tmp_path, "--horizon", 11)
    np.testing.assert_allclose(fixed["dt"], 11 / 23)
    slow = drawn(checkpoint, tmp_path, "--v-max", 0.7, "--a-max", 0.5)
    assert slow["safe"].any()
    speed = np.linalg.norm(slow["velocities"][slow["safe"]], axis=-1)
    assert speed.max() < 0.71


@pytest.mark.parametrize(
    ("data", "options", "other"),
    [
        (
            {"limits": {"v_max": 0.7, "a_max": 0.5, "horizon_s": 9.0}},
            ("--v-max", 0.7, "--a-max", 0.5, "--horizon", 9),
            ("--horizon", 12),
        ),
        ({"robot_radius": 0.9}, ("--robot-radius", 0.9), ("--robot-radius", 0.25)),
    ],
)
def test_limits_and_robot_are_those_of_the_run_s_data(
    data: dict[str, Any],
    options: tuple[object, ...],
    other: tuple[object, ...],
    checkpoint: Path,
    room: Path,
    tmp_path: Path,
) -> None:
    seen = ("--map", room, "--size", 8, "--no-project")
    asked = drawn(checkpoint, tmp_path, *seen, *options)
    of_data = tmp_path / "of_data.pt"
    save_checkpoint(of_data, replace(load_checkpoint(checkpoint), data=data))
    own = drawn(of_data, tmp_path, *seen)
    for name in ("trajectories", "dt", "clearance"):
        np.testing.assert_array_equal(own[name], asked[name])
    given = drawn(of_data, tmp_path, *seen, *other)  # an option stands above the data
    assert not np.array_equal(given["clearance"], own["clearance"])


def test_a_student_is_asked_as_it_was_taught(checkpoint: Path, tmp_path: Path) -> None:
    saved = load_checkpoint(checkpoint)
    settings = {**saved.config, "schedule": (0.0, 0.6, 1.0)}
    student = tmp_path / "student.pt"
    save_checkpoint(student, replace(saved, config=settings, teacher={"sha256": "", "step": 1}))

    def same(given: tuple[str, ...], wanted: tuple[str, ...]) -> None:
        found = [
            drawn(each, tmp_path, *words, quick=("--num-samples", "3", "--seed", "5"))
            for each, words in ((student, given), (checkpoint, wanted))
        ]
        np.testing.assert_array_equal(found[0]["trajectories"], found[1]["trajectories"])

    same((), ("--method", "euler", "--schedule", "0,0.6,1"))
    same(("--method", "midpoint"), ("--method", "midpoint", "--schedule", "0,0.6,1"))
    same(("--schedule", "8step"), ("--method", "euler", "--schedule", "8step"))
    same(("--steps", "3"), ("--method", "euler", "--steps", "3"))


def test_a_map_and_its_unknown_cells(checkpoint: Path, room: Path, tmp_path: Path) -> None:
    free = drawn(checkpoint, tmp_path, "--size", 8, "--no-project")
    walled = drawn(checkpoint, tmp_path, "--map", room, "--size", 8, "--no-project")
    assert walled["clearance"].max() < free["clearance"].min()
    run(checkpoint, "--map", room, "--size", 8, "--goal", "3,3.5", "--unknown-is-free")
    ends = ("--checkpoint", checkpoint, "--start", "-1,0.5", "--goal", "3,3.5")
    assert "x_goal: expected a cell of occupancy below 0.5" in failure(
        "generate", *ends, "--map", room
    )


def test_the_command_draws_what_the_generator_draws(checkpoint: Path, tmp_path: Path) -> None:
    arrays = drawn(checkpoint, tmp_path)
    model = make_model(num_steps=24, num_control_points=12)
    seen = empty_map(np.array([-1, 0.5]), np.array([2, -0.25]), size_m=None)
    assert seen.occupancy.shape == (EMPTY_MAP_CELLS, EMPTY_MAP_CELLS)
    anchors = TrajectoryGenerator(model, GeneratorConfig(num_samples=3, steps=2)).generate(
        seen.occupancy[None],
        [-1, 0.5, 0, 0, 0, 0],
        [2, -0.25, 0, 0],
        resolution=seen.resolution,
        origin=seen.origin,
        seed=5,
    )
    np.testing.assert_allclose(arrays["trajectories"], anchors.trajectories, atol=1e-4)


def test_a_model_with_heading(make_checkpoint: Callable[[int], Path], tmp_path: Path) -> None:
    out, picture = tmp_path / "anchors.npz", tmp_path / "anchors.svg"
    ends = ["--start", "-1,0,0.5", "--goal", "2,0,-0.5", "--out", str(out), "--plot", str(picture)]
    succeed("generate", "--checkpoint", make_checkpoint(3), *ends, *QUICK)
    with np.load(out) as arrays:
        np.testing.assert_allclose(arrays["trajectories"][:, 0], [[-1, 0, 0.5]] * 3, atol=1e-5)
    assert picture.exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--method", "rk5"), "anchorflow generate: method: expected"),
        (("--start", "0,0,1", "--goal", "1,0,0"), "x_curr: expected [6]"),
        (("--size", "1"), "x_curr: expected a position on the map"),
        (("--v-max", "-1"), "v_max: expected"),
        (("--horizon", "0"), "horizon_s: expected"),
        (("--out", "FULL"), "--out: [Errno 28]"),
        (("--checkpoint", "absent.pt"), "absent.pt: expected a checkpoint, found no file"),
    ],
)
def test_what_cannot_be_is_one_line(
    options: tuple[str, ...], said: str, checkpoint: Path, tmp_path: Path
) -> None:
    full = tmp_path / "anchors.npz"
    full.symlink_to("/dev/full")
    words = (str(full) if word == "FULL" else word for word in options)
    assert said in failure("generate", "--checkpoint", checkpoint, *ENDS, *QUICK, *words)


def test_smoothing_may_be_left_out(checkpoint: Path, tmp_path: Path) -> None:
    """The untrained field leaves the ends; only a fitted spline meets them."""
    smooth = drawn(checkpoint, tmp_path, "--no-project")
    rough = drawn(checkpoint, tmp_path, "--no-project", "--no-smooth")
    assert np.abs(smooth["trajectories"][:, 0] - [-1, 0.5]).max() < 1e-5
    assert np.abs(rough["trajectories"][:, 0] - [-1, 0.5]).max() > 1e-3
