"""Ways differ if they pass what moves on different sides, or before it and after it."""

from __future__ import annotations

import numpy as np
import pytest

from anchorflow_trajectory.movers import Discs, MovingDiscs
from anchorflow_trajectory.routes.passing import passing_keys

UNTIL = 12.0  # s
STEPS = 64
CROSSING = (0.0, -3.0), (0.0, 1.0)  # m and m/s: on the way's middle after 3 s
DESCENDING = (0.0, 3.0), (0.0, -1.0)
ONCOMING = (3.0, 0.0), (-1.0, 0.0)
STANDING = (0.0, 0.0), (0.0, 0.0)
LATE = (3.0, 20.0), (0.0, -2.0)  # on the goal after 10 s, when every way has long arrived
OVERTAKING = (-10.0, -1.0), (1.5, 0.0)  # beside the goal after 8.7 s

Motion = tuple[np.ndarray, float]
Disc = tuple[tuple[float, float], tuple[float, float]]


def way(lasting: float, *, wait: float = 0.0, aside: float = 0.0) -> Motion:
    """From (-3, 0) to (3, 0) in `lasting` s, the first `wait` of them at the start."""
    time = np.linspace(0.0, lasting, STEPS)
    share = np.clip((time - wait) / (lasting - wait), 0.0, 1.0)
    path = np.stack([6.0 * share - 3.0, aside * np.sin(np.pi * share)], -1)
    return path.astype(np.float32), lasting


FAST, LESS_FAST, SLOW, WAITED = way(4.0), way(5.0), way(8.0), way(7.0, wait=3.0)
BEFORE, BEHIND = way(4.0, aside=0.3), way(10.0, aside=-0.3)
LEFT, RIGHT = way(5.0, aside=0.8), way(5.0, aside=-0.8)
CASES = [
    pytest.param(CROSSING, FAST, SLOW, False, id="before or behind one who crosses"),
    pytest.param(CROSSING, FAST, LESS_FAST, True, id="two before one who crosses"),
    pytest.param(CROSSING, FAST, BEFORE, True, id="two before, on different curves"),
    pytest.param(CROSSING, SLOW, BEHIND, True, id="two behind, on different curves"),
    pytest.param(CROSSING, WAITED, SLOW, True, id="who waits at the start is behind"),
    pytest.param(CROSSING, WAITED, FAST, False, id="who waits at the start is not before"),
    pytest.param(DESCENDING, FAST, SLOW, False, id="before or behind from the other side"),
    pytest.param(DESCENDING, WAITED, SLOW, True, id="who waits is behind there too"),
    pytest.param(ONCOMING, LEFT, RIGHT, False, id="left or right of one who comes"),
    pytest.param(ONCOMING, LEFT, way(9.0, aside=0.6), True, id="two left of one who comes"),
    pytest.param(STANDING, LEFT, RIGHT, False, id="left or right of one who stands"),
    pytest.param(STANDING, LEFT, way(9.0, aside=0.6), True, id="two left of one who stands"),
    pytest.param(LATE, FAST, SLOW, True, id="all have arrived before it comes"),
    pytest.param(OVERTAKING, FAST, way(10.0), True, id="it overtakes on the way or at the goal"),
]


def discs(disc: Disc, legs: int = 0) -> Discs:
    """Return the disc at its velocity, or with a forecast of that many legs to the same places."""
    position, velocity = np.array(disc[:1]), np.array(disc[1:])
    if not legs:
        return Discs.of(MovingDiscs.of(position, velocity, np.full(1, 0.3)), np.float32)
    times = 0.7 * np.arange(1, legs + 1)[:, None]
    movers = MovingDiscs.of(
        position,
        None,
        np.full(1, 0.3),
        forecast=(position + times * velocity)[None],
        forecast_dt=0.7,
    )
    return Discs.of(movers, np.float32)


def keys(moving: Discs, *ways: Motion) -> list[int]:
    path, lasting = zip(*ways, strict=True)
    return passing_keys(moving, np.stack(path), np.array(lasting), UNTIL).tolist()


@pytest.mark.parametrize("legs", [0, 1, 20], ids=["velocity", "one leg", "twenty legs"])
@pytest.mark.parametrize(("disc", "one", "other", "alike"), CASES)
def test_ways_are_alike_if_they_pass_on_one_side(
    disc: Disc, one: Motion, other: Motion, alike: bool, legs: int
) -> None:
    first, second = keys(discs(disc, legs), one, other)
    assert (first == second) == alike
    assert keys(discs(disc, legs), one, other) == keys(discs(disc), one, other)


def test_a_turn_of_a_forecast_counts() -> None:
    """It comes along the way for 2 s, turns, and crosses after 5 s."""
    ahead = [[-2.5, -3.0], [0.0, -3.0], [0.0, -2.0], [0.0, -1.0]]
    turning = MovingDiscs.of(
        np.array([[-5.0, -3.0]]),
        None,
        np.full(1, 0.3),
        forecast=np.array([ahead]),
        forecast_dt=1.0,
    )
    before, also_before, behind, also_behind = keys(
        Discs.of(turning, np.float32), LESS_FAST, SLOW, way(12.0), way(12.0, aside=-0.3)
    )
    assert before == also_before != behind == also_behind


def test_each_of_several_discs_counts() -> None:
    """Before or behind each of two who cross at different places and times: three classes."""
    position, velocity = np.array([[-1.0, -2.0], [1.0, -5.0]]), np.array([[0.0, 1.0]] * 2)
    both = Discs.of(MovingDiscs.of(position, velocity, np.full(2, 0.3)), np.float32)
    # The first is on the way after 2 s, the second after 5 s.
    before_both, between, behind_both, also_between = keys(
        both, FAST, way(7.2), way(12.0), way(6.6)
    )
    assert len({before_both, between, behind_both}) == 3
    assert between == also_between
