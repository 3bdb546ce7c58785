"""GoalFlow that is told who else is there: the same trajectories, chosen by where they may go."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from anchorflow_client import AnchorBatch
from anchorflow_client.sensors import OTHERS_TIMES_S, ego_status, others_before, route_ahead
from anchorflow_service.bundle import DEFAULT_BUNDLE
from anchorflow_service.local import LocalClient

SPEED, LENGTH, WIDTH = 8.0, 4.6, 1.8


@pytest.fixture(scope="module")
def client() -> LocalClient:
    return LocalClient.of(DEFAULT_BUNDLE.parent / "goalflow", threads=1)


def scene(gap: float) -> dict[str, np.ndarray]:
    """At SPEED behind a car that drives as fast on a street 12 m wide, as the raster has it."""
    bev = np.zeros((20, 192, 128), np.uint8)
    bev[0, :, 52:76] = 255
    for channel, ahead_s in ((7, 0.0), *zip(range(11, 20), 0.5 * np.arange(1, 10), strict=True)):
        rear = round((80.0 - gap - SPEED * ahead_s) / 0.5)
        bev[channel, max(rear - 9, 0) : max(rear, 0), 62:66] = 255
    status = ego_status(command="straight", velocity=(SPEED, 0.0), acceleration=(0.0, 0.0))
    return {"bev": bev, "ego_status": status, "vehicle_size": np.array([LENGTH, WIDTH], np.float32)}


def leader(gap: float, *, braking: float) -> np.ndarray:
    times = np.array(OTHERS_TIMES_S)
    states = np.zeros((1, len(times), 5))
    states[0, :, 0] = gap + LENGTH / 2 + SPEED * times - braking / 2 * times**2
    states[0, :, 3] = SPEED - braking * times
    return others_before(states, np.array([[LENGTH, WIDTH]]), np.array([1]))


def plan(client: LocalClient, inputs: dict[str, np.ndarray], **asked: Any) -> AnchorBatch:
    return client.plan(inputs=inputs, seed=0, **asked)


def test_others_change_the_scores_and_the_worst_quarter(client: LocalClient) -> None:
    own, others = scene(12.0), {"others": leader(12.0, braking=2.0)}
    plain, told = plan(client, own), plan(client, own | others)
    kept = (plain.trajectories == told.trajectories).all((1, 2))
    assert 3 * len(kept) // 4 <= kept.sum() < len(kept)
    assert (told.scores <= plain.scores)[kept].all()
    assert not np.array_equal(told.scores[kept], plain.scores[kept])
    # Careful drives are better than the samples that they replace, and no worse than some.
    assert told.scores[~kept].min() > 0.0
    assert set(told.arrays) == set(plain.arrays)
    asked = plan(client, own | others, outputs=["futures"])
    np.testing.assert_array_equal(told.scores, asked.scores)


def test_along_a_route_careful_drives_keep_to_it(client: LocalClient) -> None:
    angle = np.linspace(0.0, 0.9, 40)
    route = 50 * np.stack([np.sin(angle), 1 - np.cos(angle)], -1).astype(np.float32)
    inputs = scene(200.0) | {"others": leader(200.0, braking=0.0), "route": route_ahead(route)}
    plain = plan(client, {name: inputs[name] for name in inputs if name != "others"})
    told = plan(client, inputs)
    new = ~(plain.trajectories == told.trajectories).all((1, 2))
    ends = told.trajectories[new, -1, :2]
    assert new.any()
    assert np.abs(np.hypot(ends[:, 0], ends[:, 1] - 50) - 50).max() < 1.3
    nowhere = plan(client, inputs | {"route": np.zeros((40, 2), np.float32)})
    untold = plan(client, {name: inputs[name] for name in inputs if name != "route"})
    np.testing.assert_array_equal(nowhere.trajectories, untold.trajectories)


def test_a_single_trajectory_is_the_better_one_of_a_sample_and_the_drives(
    client: LocalClient,
) -> None:
    inputs = scene(12.0) | {"others": leader(12.0, braking=2.0)}
    one, many = plan(client, inputs, num_samples=1), plan(client, inputs)
    assert one.trajectories.shape == (1, 8, 3)
    assert one.scores[0] <= many.scores.max() + 0.05


@pytest.mark.parametrize("delay_s", [0.0, 0.3])
def test_behind_who_brakes_a_shorter_way_is_chosen(client: LocalClient, delay_s: float) -> None:
    own = scene(12.0)
    steady, braking = (
        plan(client, own | {"others": leader(12.0, braking=rate)}, delay_s=delay_s)
        for rate in (0.0, 3.0)
    )
    ends = [answer.trajectories[answer.best, -1, 0] for answer in (steady, braking)]
    assert ends[1] < ends[0] - 2.0


def test_a_late_plan_meets_the_others_where_they_are_by_then(client: LocalClient) -> None:
    inputs = scene(6.0) | {"others": leader(6.0, braking=0.0)}
    ways = [plan(client, inputs, delay_s=delay_s) for delay_s in (0.0, 1.0)]
    at_once, late = (answer.trajectories[answer.best, -1, 0] for answer in ways)
    # It would seem to be inside of the car by now.
    assert late > at_once - 3.0


def test_a_free_road_is_told_by_zeros(client: LocalClient) -> None:
    own = scene(200.0)
    answer = plan(client, own | {"others": np.zeros((48, 5, 8), np.float32)})
    assert answer.trajectories[answer.best, -1, 0] > 3.5 * SPEED


def test_the_guard_goes_with_it(client: LocalClient) -> None:
    inputs = scene(12.0) | {"others": leader(12.0, braking=3.0)}
    guarded = plan(client, inputs, refine={"guard": True})
    assert guarded.safe.any()
