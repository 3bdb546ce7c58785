"""Plans of cars that begin where the car will be, on GoalFlow's bundle."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from anchorflow_client import AnchorBatch, AnchorRequest, InvalidRequest
from anchorflow_client.contract import resolve_for_card
from anchorflow_client.sensors import ego_status
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_service.local import LocalClient

SPEED = 8.0
FOLDER = DEFAULT_BUNDLE.parent
BRAKES = [[0.0, 0.0, 0.0, 0.0], [0.5, 3.5, 0.0, 0.0], [1.0, 6.0, 0.0, 0.0]]


@pytest.fixture(scope="module")
def client() -> LocalClient:
    return LocalClient.of(FOLDER / "goalflow", threads=1)


def street(*, scenes: int | None = None) -> dict[str, Any]:
    """Return the inputs of an empty street 12 m wide."""
    bev = np.zeros((20, 192, 128), np.uint8)
    bev[0, :, 52:76] = 255
    status = ego_status(command="straight", velocity=(SPEED, 0.0), acceleration=(0.0, 0.0))
    inputs = {"bev": bev, "ego_status": status, "vehicle_size": np.array([4.6, 1.8], np.float32)}
    return inputs if scenes is None else {n: np.stack([a] * scenes) for n, a in inputs.items()}


def plan(client: LocalClient, **asked: Any) -> AnchorBatch:
    return client.plan(inputs=street(), seed=0, **asked)


def test_without_a_delay_nothing_changes(client: LocalClient) -> None:
    bare, at_once = plan(client), plan(client, delay_s=0.0)
    assert bare.first_s == at_once.first_s == 0.5
    np.testing.assert_array_equal(bare.trajectories, at_once.trajectories)


@pytest.mark.parametrize(
    ("last_plan", "begins", "speed"), [(None, 0.3 * SPEED, SPEED), (BRAKES, 2.22, 6.6)]
)
def test_poses_are_counted_from_the_delay_and_join_what_the_car_does(
    client: LocalClient, last_plan: Any, begins: float, speed: float
) -> None:
    bare, late = plan(client), plan(client, delay_s=0.3, last_plan=last_plan)
    assert late.first_s == pytest.approx(0.8)
    assert 1e-4 < np.abs(bare.scores - late.scores).max() < 0.5  # scored as they are driven
    assert np.corrcoef(bare.scores, late.scores)[0, 1] > 0.8
    ways = late.trajectories[:, 0, :2] - np.array([begins, 0.0])
    assert np.abs(np.linalg.norm(ways, axis=1) / 0.5 - speed).max() < 2.5  # 5 m/s^2 at most
    best = bare.trajectories[bare.best, :, :2]
    near = np.linalg.norm(late.trajectories[late.best, :-1, None, :2] - best[None], axis=-1)
    assert near.min(1).max() < 2.5  # on the path of the best, whose poses are 4 m apart


def test_the_guard_judges_the_way_until_then_too_and_stops_later(client: LocalClient) -> None:
    at_once, late = (plan(client, delay_s=delay, refine={"guard": True}) for delay in (0.0, 0.3))
    assert at_once.safe[-1]
    assert late.safe[-1]
    assert late.safe.sum() > 10
    for stop, begins in ((at_once, 0.0), (late, 0.3 * SPEED)):
        moved = stop.trajectories[-1, 0, 0] - begins
        assert 0.5 * SPEED - 7 / 8 < moved < 0.5 * SPEED - 1 / 8  # it brakes from then on
        assert np.ptp(stop.trajectories[-1, -2:, 0]) < 0.2
    off_road = [[0.0, 0.0, 0.0, 0.0], [0.4, 2.0, 5.8, 1.2]]
    gone = plan(client, delay_s=0.3, last_plan=off_road, refine={"guard": True})
    assert not gone.safe.any()


ON_MAP = {
    "cost_map": {"data": np.zeros((1, 32, 32)), "resolution": 0.2},
    "x_curr": [0.0] * 6,
    "x_goal": [1.0, 0.0, 0.0, 0.0],
}
REFUSED = {
    "a map": ("default", {**ON_MAP, "delay_s": 0.1}, "delay_s", "'spline', and only planners of"),
    "too late": ("goalflow", {"delay_s": 1.5}, "delay_s", "[0, 1] s, got 1.5"),
    "no delay": ("goalflow", {"last_plan": BRAKES}, "delay_s", "required beside last_plan"),
    "too short": ("goalflow", {"delay_s": 1.0, "last_plan": BRAKES[:2]}, "last_plan", "got 0.5 s"),
    "backwards": ("goalflow", {"delay_s": 0.1, "last_plan": BRAKES[::-1]}, "last_plan", "increas"),
    "a shape": ("goalflow", {"delay_s": 0.1, "last_plan": [[0, 0, 0]] * 2}, "last_plan", "[K,4]"),
    "scenes": (
        "goalflow",
        {"delay_s": 0.1, "last_plan": BRAKES, "inputs": street(scenes=2)},
        "last_plan",
        "got B = 2",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_late_is_refused_by_name(case: str) -> None:
    bundle, asked, field, told = REFUSED[case]
    inputs = {} if bundle == "default" else {"inputs": street()}
    card = load_bundle(FOLDER / bundle).card
    with pytest.raises(InvalidRequest) as caught:
        resolve_for_card(AnchorRequest.build(**(inputs | asked)), card)
    assert caught.value.field == field
    assert told in caught.value.message
