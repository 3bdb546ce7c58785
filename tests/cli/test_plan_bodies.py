"""`anchorflow plan` for a robot with an outline and wheels: the request and the picture."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from command_line import failure, succeed
from PIL import Image
from ros_maps import write_map

from anchorflow_cli import body_plots
from anchorflow_client.contract import AnchorBatch, AnchorRequest, GoalTolerance, ModelId
from anchorflow_client.contract.body import Kinematics
from anchorflow_service.local import LocalClient
from anchorflow_trajectory.drawing import draw_outlines

CORNERS = [[0.45, 0.31], [-0.45, 0.31], [-0.45, -0.31], [0.45, -0.31]]
POSES = ("--start", "0,0,0.5", "--goal", "3,0,-90deg")


@pytest.fixture
def map_file(tmp_path: Path) -> Path:
    """A free map of 20 × 20 m, its corner at (-10, -10)."""
    return write_map(tmp_path, np.full((200, 200), 254, np.uint8), (-10.0, -10.0))


@pytest.fixture
def requests(monkeypatch: pytest.MonkeyPatch) -> list[AnchorRequest]:
    """Collect the requests to an engine that answers with one way: back, a turn, and forwards."""
    received: list[AnchorRequest] = []

    def answer(request: AnchorRequest) -> AnchorBatch:
        received.append(request)
        poses, rates = back_and_forth(request.x_curr[0, :2])
        return AnchorBatch(
            arrays={
                "trajectories": poses[None].astype(np.float32),
                "velocities": rates[None].astype(np.float32),
                "accelerations": np.zeros((1, 64, 3), np.float32),
                "scores": np.array([-1.0], np.float32),
                "clearance": np.array([0.5], np.float32),
                "safe": np.array([True]),
            },
            dt=6.3 / 63,
            seed=7,
            model=ModelId("back", "1.0.0", "0" * 64),
            timing_ms={"total": 12.0},
        )

    card = SimpleNamespace(
        name="back", cost_map=SimpleNamespace(limits=SimpleNamespace(robot_radius=0.3))
    )
    client = SimpleNamespace(plan_request=answer, models=lambda: (card,))
    monkeypatch.setattr(LocalClient, "of", lambda _: nullcontext(client))
    return received


def back_and_forth(start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return poses and rates [64, 3]: 2 s backwards along x, a quarter turn, then along y."""
    rates = np.zeros((64, 3))
    rates[:20, 0], rates[20:40, 2], rates[40:63, 1] = -0.5, np.pi / 4, 0.5
    poses = np.concatenate([np.zeros((1, 3)), 0.1 * rates[:-1].cumsum(0)])
    poses[:, :2] += start
    return poses, rates


@pytest.mark.parametrize(
    "outline",
    [
        "0.9x0.62",
        "0.45,0.31 -0.45,0.31 -0.45,-0.31 0.45,-0.31",
        "[[0.45, 0.31], [-0.45, 0.31], [-0.45, -0.31], [0.45, -0.31]]",
    ],
)
def test_an_outline_has_three_spellings(
    map_file: Path, requests: list[AnchorRequest], outline: str
) -> None:
    succeed("plan", "--map", map_file, *POSES, "--footprint", outline)
    (request,) = requests
    assert request.footprint is not None
    np.testing.assert_allclose(request.footprint, CORNERS)
    assert request.kinematics is None
    np.testing.assert_allclose(request.x_curr, [[0, 0, 0.5, 0, 0, 0, 0, 0, 0]])
    np.testing.assert_allclose(request.x_goal, [[3, 0, -np.pi / 2, 0, 0, 0]])


def test_wheels_and_their_limits_are_sent(map_file: Path, requests: list[AnchorRequest]) -> None:
    car = ("--kinematics", "ackermann", "--min-turning-radius", 1.2, "--reverse")
    succeed("plan", "--map", map_file, *POSES, *car, "--start-velocity", "0.3,0.1")
    turning = ("--kinematics", "differential", "--omega-max", 2)
    succeed("plan", "--map", map_file, *POSES, *turning)
    a_car, a_cart = requests
    assert a_car.kinematics == Kinematics("ackermann", 1.2, reverse=True)
    np.testing.assert_allclose(a_car.x_curr[0, 3:], [0.3, 0.1, 0, 0, 0, 0])
    assert a_cart.kinematics == Kinematics("differential", omega_max=2.0)
    assert a_cart.footprint is None


@pytest.mark.parametrize(
    ("goal", "asked", "sent"),
    [
        ("3,0", None, GoalTolerance(0.0)),
        ("3,0,1", None, None),
        ("3,0", "0.2", GoalTolerance(0.2)),
        ("3,0,1", "0.2", GoalTolerance(0.2, 0.0)),
        ("3,0,1", "0.2,18deg", GoalTolerance(0.2, np.pi / 10)),
    ],
)
def test_a_goal_without_a_heading_is_reached_at_any(
    map_file: Path,
    requests: list[AnchorRequest],
    goal: str,
    asked: str | None,
    sent: GoalTolerance | None,
) -> None:
    told = () if asked is None else ("--goal-tolerance", asked)
    ends = ("--start=0,0,0", "--goal", goal)
    succeed("plan", "--map", map_file, *ends, *told, "--footprint", "0.9x0.62")
    assert requests[0].goal_tolerance == sent
    assert requests[0].x_goal.shape == (1, 6)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--footprint", "0.9"), "expected 0.9x0.62, or corners such as"),
        (("--footprint", "0.9xwide"), "got '0.9xwide'"),
        (("--footprint", "1,0 0,1"), "expected 3 to 16 corners, got 2"),
        (("--footprint", "0,0.2 0.2,0 0,0.1 -0.2,0"), "expected a convex polygon"),
        (("--kinematics", "tracks"), "expected one of omni, differential, ackermann"),
        (("--kinematics", "ackermann"), "kinematics.min_turning_radius: expected a radius above 0"),
        (("--omega-max", 2), "expected --kinematics with --omega-max, got none"),
        (("--reverse",), "expected --kinematics with --reverse, got none"),
        (("--footprint", "0.9x0.62", "--start=0,0"), "expected X,Y,HEADING for a robot with"),
        (("--start=0,90deg",), "expected 2 or 3 numbers X,Y[,HEADING], got '0,90deg'"),
    ],
)
def test_a_body_that_cannot_be_read_is_one_line(
    map_file: Path, requests: list[AnchorRequest], options: tuple[str, ...], words: str
) -> None:
    said = failure("plan", "--map", map_file, *POSES, *options)
    assert words in " ".join(said.split())
    assert not requests


@pytest.mark.parametrize(
    ("body", "most"),
    [(("--footprint", "0.9x0.62"), 0.45), (("--kinematics", "differential"), 0.3)],
)
def test_the_outline_is_drawn_along_the_best_anchor(
    map_file: Path,
    tmp_path: Path,
    requests: list[AnchorRequest],
    monkeypatch: pytest.MonkeyPatch,
    body: tuple[str, str],
    most: float,
) -> None:
    drawn: list[tuple[np.ndarray, np.ndarray]] = []

    def spy(axes: object, poses: np.ndarray, corners: np.ndarray, **look: object) -> object:
        drawn.append((poses, corners))
        return draw_outlines(axes, poses, corners, **look)  # pyright: ignore

    monkeypatch.setattr(body_plots, "draw_outlines", spy)
    picture = tmp_path / "plot.png"
    succeed("plan", "--map", map_file, *POSES, *body, "--out", picture)

    assert len(requests) == 1
    forwards, backwards, on_spot = drawn
    assert backwards[0][:, 0].max() <= 0.0
    assert np.ptp(backwards[0][:, 2]) == 0.0
    np.testing.assert_allclose(on_spot[0][:, :2] - on_spot[0][0, :2], 0.0, atol=1e-6)
    np.testing.assert_allclose(forwards[0][:, 2], np.pi / 2, atol=1e-6)
    assert max(corners[:, 0].max() for _, corners in drawn) == pytest.approx(most)
    with Image.open(picture) as image:
        pixels = np.asarray(image.convert("RGB")).reshape(-1, 3).astype(int)
    mark = [int(body_plots.ON_SPOT[k : k + 2], 16) for k in (1, 3, 5)]
    assert (np.abs(pixels - mark).max(1) < 30).sum() > 50
