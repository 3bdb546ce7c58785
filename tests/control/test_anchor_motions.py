"""The controls of an anchor move the robot's model along the anchor."""

from __future__ import annotations

import numpy as np
import pytest
from analytic_anchors import batch_of, straight, wheeled

from anchorflow_client import AnchorBatch, InvalidRequest
from anchorflow_control import Robot
from anchorflow_control.anchor_motions import check_motions, follow, references
from anchorflow_control.dynamics import Limits, drive

DT, STEPS = 0.1, 40


def followed(
    robot: Robot, batch: AnchorBatch, state: list[float], *, elapsed_s: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Return the driven states [T,5] along the first anchor, and the anchor's own [T,5]."""
    limits, place = Limits.of(robot), np.array(state[:2])
    wanted = references(
        batch,
        np.array([0]),
        place,
        kind=limits.kind,
        elapsed_s=elapsed_s,
        dt=DT,
        least=STEPS + 1,
        heading=state[2],
    )
    start = np.array([0.0, 0.0, *state[2:]], np.float32)
    controls, states = np.empty((1, STEPS, 2), np.float32), np.empty((1, STEPS, 5), np.float32)
    follow(limits, start, wanted, np.ones(1, np.float32), np.float32(DT), controls)
    drive(limits, start, np.float32(DT), controls, states)
    states[0, :, :2] += place
    wanted[0, :, :2] += place
    return states[0], wanted[0, 1 : STEPS + 1]


def eased(seconds: float, most: float):
    """Return a speed in time: from rest to `most` within `seconds`, smoothly."""
    return lambda t: most * 0.5 * (1.0 - np.cos(np.pi * np.minimum(t / seconds, 1.0)))


def winding(t: np.ndarray) -> np.ndarray:
    return 1.1 * np.sin(1.3 * t)


@pytest.mark.parametrize("heading", [False, True])
@pytest.mark.parametrize("kind", ["differential", "ackermann"])
def test_on_wheels(kind: str, heading: bool) -> None:
    robot = Robot(kind=kind, v_max=1.0, a_max=1.5, radius=0.3, min_turning_radius=0.6)
    anchor = wheeled(eased(1.5, 0.9), winding, dt=0.13, steps=40, heading=heading)
    driven, wanted = followed(robot, batch_of(anchor, dt=0.13), [0.0] * 5)

    assert np.linalg.norm(driven[:, :2] - wanted[:, :2], axis=1).max() < 0.05
    assert np.abs(driven[:, 3] - wanted[:, 3]).max() < 0.06
    assert np.abs(driven[10:, 4] - wanted[10:, 4]).max() < 0.15
    assert np.linalg.norm(wanted[-1, :2]) > 2.0


def test_backwards() -> None:
    robot = Robot(
        kind="ackermann", v_max=1.0, a_max=1.5, radius=0.3, min_turning_radius=0.6, reverse=True
    )
    anchor = wheeled(lambda t: -eased(1.5, 0.6)(t), winding, dt=0.1, steps=60, heading=True)
    driven, wanted = followed(robot, batch_of(anchor, dt=0.1), [0.0] * 5)

    assert np.linalg.norm(driven[:, :2] - wanted[:, :2], axis=1).max() < 0.05
    assert driven[-1, 3] < -0.5


def test_sideways() -> None:
    robot = Robot(kind="omni", v_max=1.0, a_max=1.5, radius=0.3)
    times = 0.13 * np.arange(50)[:, None]
    at, rate = np.array([0.9, 1.4]), np.array([1.0, 0.7])
    p = at * (1.0 - np.cos(rate * times)) * [0.6, 0.5]
    v = at * rate * np.sin(rate * times) * [0.6, 0.5]
    a = at * rate**2 * np.cos(rate * times) * [0.6, 0.5]
    driven, wanted = followed(robot, batch_of((p, v, a), dt=0.13), [0.0, 0.0, 0.7, 0.0, 0.0])

    assert np.linalg.norm(driven[:, :2] - wanted[:, :2], axis=1).max() < 0.02
    np.testing.assert_allclose(driven[:, 2], 0.7, atol=1e-6)


def test_from_within_the_anchor() -> None:
    """A plan has aged by a second, and the robot is on it."""
    robot = Robot(kind="differential", v_max=1.0, a_max=1.5, radius=0.3)
    p, v, a = wheeled(eased(1.0, 0.8), winding, dt=0.1, steps=80, heading=True)
    state = [*p[10], 0.8, v[10, 2]]
    driven, wanted = followed(robot, batch_of((p, v, a), dt=0.1), state, elapsed_s=1.0)

    np.testing.assert_allclose(wanted[:40, :3], p[11:51], atol=1e-3)
    assert np.linalg.norm(driven[:, :2] - p[11:51, :2], axis=1).max() < 0.02


def test_an_anchor_is_entered_where_the_robot_is() -> None:
    robot = Robot(kind="omni", v_max=1.0, a_max=1.5, radius=0.3)
    p, v, a = straight([0.0, 0.0], [4.0, 0.0], seconds=6.0, steps=64)
    driven, _ = followed(robot, batch_of((p, v, a), dt=6.0 / 63), [1.5, 0.0, 0.0, v[25, 0], 0.0])
    assert np.diff(driven[:, 0]).min() > -1e-3  # it does not turn back to the beginning
    assert driven[-1, 0] == pytest.approx(4.0, abs=0.1)


def test_beside_the_anchor_it_comes_back() -> None:
    robot = Robot(kind="differential", v_max=1.0, a_max=1.5, radius=0.3)
    anchor = straight([0.0, 0.0], [4.0, 0.0], seconds=6.0, steps=64)
    driven, wanted = followed(robot, batch_of(anchor, dt=6.0 / 63), [-0.1, 0.3, -0.5, 0.0, 0.0])

    assert np.abs(driven[-5:, 1]).max() < 0.03
    assert np.abs(driven[-5:, 2]).max() < 0.05
    assert wanted[-1, 0] - driven[-1, 0] < 0.6  # the anchor waited for it


def test_a_robot_that_faces_away_turns_on_the_spot_first() -> None:
    robot = Robot(kind="differential", v_max=1.0, a_max=1.5, radius=0.3, omega_max=2.0)
    anchor = straight([0.0, 0.0], [4.0, 0.0], seconds=6.0, steps=64)
    driven, _ = followed(robot, batch_of(anchor, dt=6.0 / 63), [0.0, 0.0, np.pi, 0.0, 0.0])
    facing = np.cos(driven[:, 2]) > 0.7

    assert np.linalg.norm(driven[~facing][:, :2], axis=1).max() < 0.05
    assert driven[-1, 0] > 0.5


def test_after_its_end_an_anchor_goes_on_straight() -> None:
    robot = Robot(kind="omni", v_max=1.0, a_max=1.5, radius=0.3)
    p, v = np.array([[0.0, 0.0], [0.5, 0.0]]), np.array([[0.5, 0.0], [0.5, 0.0]])
    _, wanted = followed(robot, batch_of((p, v, 0.0 * v), dt=1.0), [0.0, 0.0, 0.0, 0.5, 0.0])

    np.testing.assert_allclose(wanted[:, 0], 0.5 * DT * np.arange(1, STEPS + 1), atol=1e-5)


def test_anchors_without_velocities_are_refused() -> None:
    p, v, a = straight([0.0, 0.0], [4.0, 0.0], seconds=6.0, steps=8)
    batch = batch_of((p, v, a), dt=1.0)
    arrays = {"trajectories": batch.trajectories}
    bare = AnchorBatch(arrays=arrays, dt=1.0, seed=0, model=batch.model, timing_ms={})
    with pytest.raises(InvalidRequest, match="anchors: expected velocities"):
        check_motions(bare)
    several = {name: array[None] for name, array in batch.arrays.items()}
    with pytest.raises(InvalidRequest, match="expected the anchors of one scene, got a B axis"):
        check_motions(AnchorBatch(arrays=several, dt=1.0, seed=0, model=batch.model, timing_ms={}))
