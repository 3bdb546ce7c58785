"""Anchors for robots with an outline and wheels, as a caller meets them, by the student."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from asked_engine import plan

from anchorflow_benchmarks import bodies
from anchorflow_benchmarks.body_judge import BodyJudge, ahead, driven, sideways
from anchorflow_client.contract import AnchorBatch, AnchorRequest
from anchorflow_client.errors import InvalidRequest
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_service.engine import Engine

CELLS, RESOLUTION = 120, 0.05
V_MAX, A_MAX, OMEGA_MAX, RADIUS = 1.0, 1.5, 2.0, 1.0
FORKLIFT = np.array([[-0.45, -0.31], [0.45, -0.31], [0.45, 0.31], [-0.45, 0.31]])
CAR = np.array([[-0.2, -0.225], [0.5, -0.225], [0.5, 0.225], [-0.2, 0.225]])
TURNS = {"kind": "differential", "omega_max": OMEGA_MAX}
DRIVES = {"kind": "ackermann", "min_turning_radius": RADIUS, "omega_max": OMEGA_MAX}
Place = tuple[float, float, float]


@pytest.fixture(scope="module")
def engine() -> Engine:
    return Engine(load_bundle(DEFAULT_BUNDLE.parent / "student"), threads=2)


def walls(*free: tuple[float, float, float, float], filled: bool = True) -> np.ndarray:
    """[H, W], occupied but for rectangles of x and y [m] from and to, or the other way round."""
    cells = np.full((CELLS, CELLS), filled)
    for x0, x1, y0, y1 in free:
        (left, right), (low, high) = (
            np.round(np.array(ends) / RESOLUTION + CELLS / 2).astype(int)
            for ends in ((x0, x1), (y0, y1))
        )
        cells[low:high, left:right] = not filled
    return cells


DOOR = walls((-3, 3, -3, 3)) | walls((-0.1, 0.1, -3, 3), filled=False)
DOOR &= ~walls((-0.1, 0.1, 0.4, 1.2), filled=False)
CORRIDOR = walls((-2.9, 2.9, -0.62, 0.62))
FREE = walls((-3, 3, -3, 3))


def asked(
    engine: Engine, occupied: np.ndarray, start: Place, goal: Place, **changes: Any
) -> AnchorBatch:
    request = {
        "cost_map": {"data": occupied[None].astype(np.float32), "resolution": RESOLUTION},
        "x_curr": [*start, *[0.0] * 6],
        "x_goal": [*goal, *[0.0] * 3],
        "footprint": FORKLIFT,
        "kinematics": TURNS,
        "goal_tolerance": {"position": 0.1},
        "v_max": V_MAX,
        "a_max": A_MAX,
        "num_samples": 24,
        "seed": 3,
    }
    return plan(engine, AnchorRequest.build(**(request | changes)))


def assert_driven(
    anchors: AnchorBatch,
    occupied: np.ndarray,
    footprint: np.ndarray = FORKLIFT,
    *,
    slides: bool = False,
) -> None:
    """Safe anchors touch nothing, keep the limits and slip nowhere; their derivatives agree."""
    assert anchors.is_finite
    assert anchors.safe.any(), "nothing is safe"
    judge = BodyJudge(occupied, RESOLUTION, footprint)
    poses, velocities = anchors.trajectories[anchors.safe], anchors.velocities[anchors.safe]
    accelerations = anchors.accelerations[anchors.safe]
    steps = (np.broadcast_to(anchors.dt, anchors.safe.shape))[anchors.safe]
    assert not any(judge.touches(path) for path in poses)
    assert slides or np.abs(sideways(poses, velocities)).max() < 1e-5
    assert np.abs(velocities[..., 2]).max() <= OMEGA_MAX
    assert np.hypot(velocities[..., 0], velocities[..., 1]).max() <= V_MAX
    assert np.hypot(accelerations[..., 0], accelerations[..., 1]).max() <= A_MAX
    for path, velocity, pull, dt in zip(poses, velocities, accelerations, steps, strict=True):
        moved, changed = np.diff(path, axis=0), np.diff(velocity, axis=0)
        middle = 0.5 * (velocity[1:] + velocity[:-1])
        between = np.sqrt(((moved / dt - middle) ** 2).mean(0))
        assert between[:2].max() < 0.03
        assert between[2] < 0.15  # turns on the spot begin at omega_max in 0.4 s
        # A turn on the spot begins and ends between two samples.
        between = np.sqrt(((changed / dt - 0.5 * (pull[1:] + pull[:-1])) ** 2).mean(0))
        assert between[:2].max() < 0.35


def test_a_forklift_goes_through_a_door_that_its_disc_does_not_fit(engine: Engine) -> None:
    start, goal = (-2.0, -1.0, 0.4), (2.0, -1.0, 0.0)
    anchors = asked(engine, DOOR, start, goal)
    assert anchors.safe.mean() > 0.9
    assert_driven(anchors, DOOR)
    np.testing.assert_allclose(anchors.trajectories[:, 0], [start] * 24, atol=1e-6)
    ends = anchors.trajectories[anchors.safe, -1, :2]
    np.testing.assert_allclose(ends, [goal[:2]] * len(ends), atol=1e-3)
    disc = asked(
        engine, DOOR, (*start[:2], 0.0), goal, footprint=None, kinematics=None,
        x_curr=[*start[:2], 0, 0, 0, 0], x_goal=[*goal[:2], 0, 0], robot_radius=0.546,
    )  # fmt: skip
    assert not disc.safe.any()


def test_a_goal_behind_is_reached_by_turning_on_the_spot(engine: Engine) -> None:
    anchors = asked(engine, CORRIDOR, (1.0, 0.0, 0.0), (-1.5, 0.0, 0.0))
    assert_driven(anchors, CORRIDOR)
    path, velocity = anchors.trajectories[anchors.best], anchors.velocities[anchors.best]
    assert ahead(path, velocity).min() > -1e-6
    assert abs(path[-1, 2]) == pytest.approx(np.pi, abs=0.3)
    still = np.abs(velocity[:, :2]).max(1) < 1e-6
    assert np.ptp(path[still, 2]) > 2.0


def test_backwards_is_driven_where_it_is_allowed(engine: Engine) -> None:
    anchors = asked(
        engine, CORRIDOR, (1.0, 0.0, 0.0), (-1.5, 0.0, 0.0), kinematics=TURNS | {"reverse": True}
    )
    assert_driven(anchors, CORRIDOR)
    best = anchors.best
    assert ahead(anchors.trajectories[best], anchors.velocities[best]).max() < 1e-6
    assert abs(anchors.trajectories[best, -1, 2]) < 0.3


@pytest.mark.parametrize("seed", [2, 5, 18])
def test_a_car_parks_in_a_gap_and_parks_on_while_it_moves(engine: Engine, seed: int) -> None:
    at = bodies.parking(np.random.default_rng([seed, 7]))
    anchors = plan(engine, AnchorRequest.build(**at.fields(16, 0)))
    best = anchors.best
    path, velocity = anchors.trajectories[best], anchors.velocities[best]
    assert bodies.verdicts(anchors, at)[best].all()
    assert anchors.safe[best]
    speed = ahead(path, velocity)
    cusps = np.flatnonzero(np.diff(np.sign(np.where(np.abs(speed) > 0.02, speed, 0.0))))
    assert len(cusps)
    assert np.abs(speed[[0, -1]]).max() < 1e-6
    end = driven(path, velocity, float(anchors.durations[best]))
    np.testing.assert_allclose(end, at.goal, atol=0.05)
    assert float(anchors.durations[best]) < 10.0  # no loop round the block

    t = 8
    state = [*path[t], *velocity[t], *anchors.accelerations[best, t]]
    moving: dict[str, Any] = {**at.fields(16, 0), "x_curr": state}
    on = plan(engine, AnchorRequest.build(**moving))
    assert on.safe.any()
    first = on.velocities[on.safe, 0]
    np.testing.assert_allclose(first, [velocity[t]] * len(first), atol=0.05)


BAY = walls((-2.9, 2.9, -0.4, 2.0), (-0.55, 0.55, -1.3, 0.0))


@pytest.mark.parametrize(
    ("occupied", "start", "velocity", "goal"),
    [
        (BAY, (-1.5, 0.4, 0.0), (0.0, 0.0, 0.0), (0.0, -0.9, 0.0)),  # a bay it cannot turn in
        (FREE, (-2.0, -1.0, 0.0), (0.1, 0.6, 0.3), (2.0, 1.0, 2.5)),  # turns while it drives
    ],
)
def test_an_omni_robot_slides(
    engine: Engine, occupied: np.ndarray, start: Place, velocity: Place, goal: Place
) -> None:
    anchors = asked(
        engine, occupied, start, goal, x_curr=[*start, *velocity, 0.0, 0.0, 0.0],
        kinematics={"kind": "omni", "omega_max": OMEGA_MAX}, goal_tolerance=None,
    )  # fmt: skip
    assert_driven(anchors, occupied, slides=True)
    assert anchors.safe.mean() > 0.9
    for t, wanted in ((0, start), (-1, goal)):
        np.testing.assert_allclose(anchors.trajectories[:, t], [wanted] * 24, atol=1e-3)
    np.testing.assert_allclose(anchors.velocities[:, 0], [velocity] * 24, atol=0.02)
    assert np.abs(sideways(anchors.trajectories, anchors.velocities)).max(1).min() > 0.3
    if occupied is BAY:
        wheels = asked(engine, occupied, start, goal, goal_tolerance=None)
        assert not wheels.safe.any()


def test_a_robot_that_moves_goes_on_as_it_moves(engine: Engine) -> None:
    speed, turn = 0.6, 0.3
    state = [-2.0, 0.0, 0.2, speed * np.cos(0.2), speed * np.sin(0.2), turn, 0.0, 0.0, 0.0]
    anchors = asked(engine, FREE, (0, 0, 0), (2.0, 0.5, 0.0), x_curr=state)
    assert_driven(anchors, FREE)
    first = anchors.velocities[anchors.safe, 0]
    np.testing.assert_allclose(first, [state[3:6]] * len(first), atol=0.05)


def test_one_too_fast_for_the_wall_ahead_is_told_so(engine: Engine) -> None:
    state = [2.2, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    anchors = asked(engine, CORRIDOR, (0, 0, 0), (-1.5, 0.0, 0.0), x_curr=state)
    assert not anchors.safe.any()


@pytest.mark.parametrize(
    ("occupied", "place", "velocity"),
    [
        (FREE, [0.0, -1.2], [0.0, 0.5]),  # crosses
        (walls((-2.9, 2.9, -1.1, 1.1)), [1.5, 0.1], [-0.7, 0.0]),  # comes: waiting does not help
    ],
)
def test_what_moves_is_passed(
    engine: Engine, occupied: np.ndarray, place: list[float], velocity: list[float]
) -> None:
    person = {"position": [place], "velocity": [velocity], "radius": [0.3]}
    start, goal = (-2.0, 0.0, 0.0), (2.0, 0.0, 0.0)
    anchors = asked(engine, occupied, start, goal, obstacles=person)
    assert_driven(anchors, occupied)
    assert anchors.safe.mean() > 0.9
    judge, blind = BodyJudge(occupied, RESOLUTION, FORKLIFT), asked(engine, occupied, start, goal)
    places = np.array([[place, np.add(place, velocity)]])

    def met(batch: AnchorBatch) -> list[bool]:
        lasting = batch.durations.tolist()
        pairs = zip(batch.trajectories, lasting, batch.safe, strict=True)
        return [judge.meets(path, s, places, np.array([0.3])) for path, s, safe in pairs if safe]

    assert not any(met(anchors))
    assert any(met(blind))


def test_a_horizon_is_kept(engine: Engine) -> None:
    for horizon_s in (3.0, 20.0):
        anchors = asked(engine, FREE, (-2.0, 0.0, 0.0), (2.0, 0.0, 0.0), horizon_s=horizon_s)
        assert anchors.durations.tolist() == pytest.approx([horizon_s] * 24)
        assert_driven(anchors, FREE)
    np.testing.assert_allclose(anchors.trajectories[:, -1, :2], [[2.0, 0.0]] * 24, atol=1e-3)


def test_a_blocked_goal_moves_within_its_tolerance(engine: Engine) -> None:
    occupied = FREE | walls((1.9, 2.1, -0.1, 0.1), filled=False)
    start, goal = (-2.0, 0.0, 0.0), (1.4, 0.0, 0.0)
    tight = asked(engine, occupied, start, goal)
    assert not tight.safe.any() or np.hypot(*(tight.trajectories[0, -1, :2] - goal[:2])) <= 0.1
    wide = asked(engine, occupied, start, goal, goal_tolerance={"position": 0.6, "heading": 0.5})
    assert_driven(wide, occupied)
    ends = wide.trajectories[wide.safe, -1]
    assert (np.hypot(*(ends[:, :2] - goal[:2]).T) <= 0.6).all()
    assert (np.abs(ends[:, 2]) <= 0.5).all()


def test_scenes_far_from_zero_and_in_a_batch_have_the_same_answers(engine: Engine) -> None:
    start, goal = (-2.0, -1.0, 0.4), (2.0, -1.0, 0.0)
    here = asked(engine, DOOR, start, goal)
    batch = asked(
        engine, DOOR, start, goal,
        x_curr=[[*start, *[0.0] * 6]] * 2, x_goal=[[*goal, *[0.0] * 3]] * 2,
    )  # fmt: skip
    np.testing.assert_array_equal(batch.trajectories[1], here.trajectories)
    far = np.array([400_000.0, 5_000_000.0])
    moved = asked(
        engine, DOOR, start, goal,
        cost_map={
            "data": DOOR[None].astype(np.float32), "resolution": RESOLUTION, "origin": far - 3.0,
        },
        x_curr=[*(far + start[:2]), start[2], *[0.0] * 6],
        x_goal=[*(far + goal[:2]), goal[2], *[0.0] * 3],
    )  # fmt: skip
    np.testing.assert_allclose(
        moved.trajectories[..., :2] - far, here.trajectories[..., :2], atol=1e-3
    )


@pytest.mark.parametrize(
    ("changes", "field", "words"),
    [
        ({"x_curr": [0.0] * 6, "x_goal": [1.0, 0, 0, 0]}, "x_curr", r"\[9\].*footprint.*poses"),
        ({"warm_start": {"trajectory": [[0, 0, 0], [1, 0, 0]]}}, "warm_start", "expected none"),
        ({"sampler": {"method": "euler"}}, "sampler", "expected none"),
    ],
)
def test_what_poses_cannot_be_asked_with_is_named(
    engine: Engine, changes: dict[str, Any], field: str, words: str
) -> None:
    with pytest.raises(InvalidRequest, match=words) as caught:
        asked(engine, FREE, (0, 0, 0), (1, 0, 0), **changes)
    assert caught.value.field == field
