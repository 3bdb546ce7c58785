"""The guard of cars in the engine, on GoalFlow's bundle: a street with a car that stands in it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from anchorflow_client import AnchorBatch, AnchorRequest, InvalidRequest
from anchorflow_client.contract import resolve_for_card
from anchorflow_client.sensors import ego_status
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_service.engine.guard import ranked
from anchorflow_service.local import LocalClient

SPEED = 8.0
FOLDER = DEFAULT_BUNDLE.parent


@pytest.fixture(scope="module")
def client() -> LocalClient:
    return LocalClient.of(FOLDER / "goalflow", threads=1)


def plan(client: LocalClient, *, ahead: float | None, **asked: Any) -> AnchorBatch:
    """Plan at SPEED on a street 12 m wide, behind a car whose rear is `ahead` m off."""
    bev = np.zeros((20, 192, 128), np.uint8)
    bev[0, :, 52:76] = 255
    if ahead is not None:
        rear = round((80.0 - ahead) / 0.5)
        for channel in (7, *range(11, 20)):
            bev[channel, rear - 9 : rear, 60:68] = 255
    status = ego_status(command="straight", velocity=(SPEED, 0.0), acceleration=(0.0, 0.0))
    inputs = {"bev": bev, "ego_status": status, "vehicle_size": np.array([4.6, 1.8], np.float32)}
    return client.plan(inputs=inputs, seed=0, **asked)


def test_without_the_guard_nothing_changes(client: LocalClient) -> None:
    bare, refused = (plan(client, ahead=30.0, **o) for o in ({}, {"refine": {"guard": False}}))
    assert set(bare.arrays) == {"trajectories", "scores"}
    for name, array in bare.arrays.items():
        np.testing.assert_array_equal(array, refused.arrays[name])


def test_guarded_scores_put_the_safe_before_the_stop_and_the_stop_before_the_rest(
    client: LocalClient,
) -> None:
    bare = plan(client, ahead=16.0)
    guarded = plan(client, ahead=16.0, refine={"guard": True})
    assert guarded.trajectories.shape == bare.trajectories.shape
    *safe, of_stop = guarded.safe
    assert of_stop
    assert 0 < sum(safe) < len(safe)
    *scores, stop = guarded.scores
    assert min(np.array(scores)[safe]) > stop > max(np.array(scores)[~np.array(safe)])
    assert guarded.best != len(safe)
    kept = {row.tobytes() for row in bare.trajectories}
    assert {row.tobytes() for row in guarded.trajectories[:-1]} < kept
    ways = np.linalg.norm(np.diff(guarded.trajectories[-1, -2:, :2], axis=0))
    assert ways < 0.2  # it stands
    assert guarded.reason is None


def test_one_trajectory_is_replaced_only_if_it_is_not_safe(client: LocalClient) -> None:
    bare, guarded = (
        plan(client, ahead=None, num_samples=1, **o) for o in ({}, {"refine": {"guard": True}})
    )
    np.testing.assert_array_equal(bare.trajectories, guarded.trajectories)
    assert guarded.safe.tolist() == [True]
    wall = plan(client, ahead=4.0, num_samples=1, refine={"guard": True})
    assert wall.safe.tolist() == [False]
    assert wall.reason is not None
    assert "a stop would hit a perceived box after 0." in wall.reason


def test_scores_of_the_others_keep_their_differences() -> None:
    scores = np.array([0.5, 0.9, 0.2, 0.7], np.float32)
    mixed = ranked(scores, np.array([True, False, True, False]))
    np.testing.assert_allclose(mixed, [0.5, -1.8, 0.2, -2.0, -0.8], atol=1e-6)
    none = ranked(scores, np.zeros(4, bool))
    np.testing.assert_allclose(none, [*scores, 1.9], atol=1e-6)


@pytest.mark.parametrize(
    ("bundle", "refine", "field"),
    [("goalflow", {"smooth": True}, "refine.smooth"), ("default", {"guard": True}, "refine.guard")],
)
def test_a_finish_is_refused_what_it_does_not_have(
    bundle: str, refine: dict[str, bool], field: str
) -> None:
    card, free = load_bundle(FOLDER / bundle).card, np.zeros((1, 32, 32))
    of_map: dict[str, Any] = {"x_curr": [0.0] * 6, "x_goal": [1.0, 0.0, 0.0, 0.0]}
    of_map |= {"cost_map": {"data": free, "resolution": 0.2}}
    given: dict[str, Any] = of_map if bundle == "default" else {"inputs": {"bev": 0}}
    request = AnchorRequest.build(**given, refine=refine)
    with pytest.raises(InvalidRequest) as caught:
        resolve_for_card(request, card)
    assert caught.value.field == field
