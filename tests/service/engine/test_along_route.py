"""The choice along a route, on the shipped bundles of planners that see by sensors."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from anchorflow_client import AnchorBatch
from anchorflow_client.contract.batch import beside_route
from anchorflow_client.sensors import ego_status, route_ahead
from anchorflow_service.bundle import DEFAULT_BUNDLE
from anchorflow_service.engine.along_route import differing, turned_from
from anchorflow_service.local import LocalClient
from anchorflow_trajectory.car.course import Course

MOST = {"wote": 64, "diffusiondrive": 32}
ASIDE = route_ahead([[0.0, 0.0], [80.0, 24.0]])


@pytest.fixture(scope="module", params=MOST)
def client(request: pytest.FixtureRequest) -> LocalClient:
    return LocalClient.of(DEFAULT_BUNDLE.parent / request.param, threads=1)


def plan(client: LocalClient, *, outputs: tuple[str, ...] = (), **asked: Any) -> AnchorBatch:
    """Plan all anchors from noise that no sensor gives, at 6 m/s to the left."""
    generator = np.random.default_rng(5)
    status = ego_status(command="left", velocity=(6.0, 0.0), acceleration=(0.0, 0.0))
    inputs = {
        "camera": generator.integers(0, 255, (3, 128, 512), np.uint8),
        "lidar": (generator.random((1, 256, 256), np.float32) > 0.99).astype(np.float32),
        "ego_status": status,
    }
    most = MOST[client.engine.card.name]
    return client.plan(inputs=inputs | asked, num_samples=most, seed=0, outputs=outputs)


def test_what_ends_beside_the_route_or_is_turned_from_it_loses_score(client: LocalClient) -> None:
    alone, told = plan(client), plan(client, route=ASIDE)
    assert "route" in alone.absent_inputs
    assert "route" not in told.absent_inputs
    known = {way.tobytes(): index for index, way in enumerate(alone.trajectories)}
    pairs = [
        (known[w.tobytes()], i) for i, w in enumerate(told.trajectories) if w.tobytes() in known
    ]
    assert len(pairs) >= 5  # others have come from among those that were not scored finely
    before, after = (np.array(each) for each in zip(*pairs, strict=True))
    beside = beside_route(told.trajectories[:, -1, :2], ASIDE)
    assert beside.max() > 2.0 > beside.min()
    if client.engine.card.name == "wote":  # the other's fine scores look at their neighbours
        lost = alone.scores[before] - told.scores[after]
        turned = np.abs(told.trajectories[after, :, 2] - np.arctan2(24.0, 80.0)).mean(1)
        expected = 0.2 * np.maximum(beside[after] - 2, 0) + 0.6 * turned
        np.testing.assert_allclose(lost, expected, atol=1e-5)
    away = beside_route(alone.trajectories[:, -1, :2], ASIDE)
    assert beside[:8].mean() < away[:8].mean() - 0.1
    assert (np.diff(told.scores) <= 0).all()


def test_poses_are_turned_from_the_nearest_place_of_a_bent_course() -> None:
    angle = np.linspace(0.0, np.pi, 200)
    course = Course(20 * np.stack([np.sin(angle), 1 - np.cos(angle)], -1))
    place = np.array([0.3, 1.5, 3.0])
    turn = np.array([0.0, 0.4, -0.4])
    poses = np.stack([18 * np.sin(place), 20 - 18 * np.cos(place), place + turn], -1)
    round_again = poses + np.array([0.0, 0.0, 2 * np.pi])
    for each in (poses, round_again):
        np.testing.assert_allclose(turned_from(each, course), np.abs(turn), atol=0.02)


def test_a_route_without_length_is_not_told(client: LocalClient) -> None:
    alone, zeros = plan(client), plan(client, route=np.zeros((40, 2), np.float32))
    np.testing.assert_array_equal(alone.trajectories, zeros.trajectories)
    np.testing.assert_array_equal(alone.scores, zeros.scores)


def test_of_those_that_are_kept_the_last_differ() -> None:
    generator = np.random.default_rng(2)
    ends = generator.uniform(0.0, 60.0, (60, 1, 1))
    ways = np.concatenate([ends * np.linspace(0, 1, 8)[:, None] * [1.0, 0.0]] * 3)
    scores = generator.random(180)
    order = np.argsort(-scores)
    chosen = differing(scores, ways, 12, alike=8)
    np.testing.assert_array_equal(chosen[:8], order[:8])
    gaps = np.linalg.norm(ways[chosen][:, None] - ways[chosen], axis=-1)
    apart = np.sqrt((gaps**2).mean(-1))
    assert apart[8:][~np.eye(12, dtype=bool)[8:]].min() > 2.0
    assert (np.diff(scores[chosen[8:]]) < 0).all()
    better = order[~np.isin(order, chosen) & (scores[order] > scores[chosen[-1]])]
    near = np.linalg.norm(ways[better][:, None] - ways[chosen], axis=-1)
    assert np.sqrt((near**2).mean(-1)).min(1).max() <= 2.0
    assert len({*differing(scores, ways, 150, alike=8).tolist()}) == 150


def test_along_a_route_the_longer_of_two_equals_is_better() -> None:
    client = LocalClient.of(DEFAULT_BUNDLE.parent / "diffusiondrive", threads=1)
    straight = route_ahead([[0.0, 0.0], [80.0, 0.0]])
    told = plan(client, route=straight, outputs=("sub_scores",))
    way = np.linalg.norm(np.diff(told.trajectories[..., :2], axis=1, prepend=0), axis=-1).sum(1)
    beside = 0.2 * np.maximum(beside_route(told.trajectories[:, -1, :2], straight) - 2, 0)
    turned = 0.6 * np.abs(told.trajectories[..., 2]).mean(1)
    own = told.scores + beside + turned
    sub = told.arrays["sub_scores"]
    network = sub[:, 0] * sub[:, 1] * (sub[:, 2:] @ [5, 5, 2]) / 12
    short = 0.05 * (1 - way / way.max())
    assert way.max() - way.min() > 5.0
    # The network's own score is at most that of its sub-scores, and near it for the best.
    assert (own + short <= network + 1e-4).all()
    assert (own + short > network - 0.02)[0]
