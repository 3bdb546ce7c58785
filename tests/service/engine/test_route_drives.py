"""Drives along a route among the trajectories of planners that see by sensors."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from anchorflow_client import InvalidRequest
from anchorflow_client.contract.batch import beside_route
from anchorflow_client.sensors import ego_status, lidar_histogram, route_ahead
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_service.engine.route_drives import RouteDrives
from anchorflow_service.local import LocalClient

BUNDLES = DEFAULT_BUNDLE.parent
ROUTE = route_ahead([[0.0, 0.0], [80.0, 0.0]])
TIMES = np.arange(1, 9) / 2
OWN = np.stack([6.0 * TIMES, 0.5 * TIMES, 0 * TIMES], -1)[None]


def person(x: float) -> np.ndarray:
    body = np.random.default_rng(1).uniform([x, -0.2, 0.3], [x + 0.4, 0.2, 1.7], (60, 3))
    return lidar_histogram(body)


class Scene:
    """A scene with a LiDAR sweep, at 8 m/s."""

    def __init__(self, lidar: np.ndarray) -> None:
        status = ego_status(command="straight", velocity=(8.0, 0.0), acceleration=(0.0, 0.0))
        self._inputs = {"lidar": lidar, "ego_status": status}
        self.request = SimpleNamespace(inputs=self._inputs, delay_s=0.0)

    def inputs(self, names: Any) -> dict[str, np.ndarray]:
        return {name: self._inputs[name][None] for name in names}


@pytest.mark.parametrize("name", ["wote", "diffusiondrive"])
def test_the_best_drives_along_the_route_and_stops_for_whom_the_lidar_sees(name: str) -> None:
    manifest = load_bundle(BUNDLES / name).manifest
    assert RouteDrives.is_possible(manifest)
    road = np.zeros((1, 8, 128, 256), np.float32)
    context = {"bev_semantics": road, "foretold": np.zeros((1, 20, 104, 64), np.float32)}

    def best(lidar: np.ndarray) -> np.ndarray:
        scene: Any = Scene(lidar)
        scores, ways = RouteDrives(manifest).among(np.zeros(1), OWN, ROUTE, scene, context)
        np.testing.assert_array_equal(ways[0], OWN[0])
        assert scores[1:].min() >= scores[0]
        return ways[scores.argmax()]

    free = best(np.zeros((1, 256, 256), np.float32))
    assert abs(free[-1, 1]) < 0.1
    assert free[-1, 0] > 32.0
    braking = best(person(18.0))
    assert braking[-1, 0] < 18.0 - 0.78 * 5.176  # the bumper does not reach him
    assert braking[-1, 0] > 5.0


@pytest.mark.parametrize("name", ["wote", "diffusiondrive"])
def test_answers_with_a_route_hold_drives_without_extras(name: str) -> None:
    client = LocalClient.of(BUNDLES / name, threads=1)
    camera = np.random.default_rng(2).integers(0, 255, (3, 128, 512), np.uint8)
    status = ego_status(command="straight", velocity=(8.0, 0.0), acceleration=(0.0, 0.0))
    lidar = np.zeros((1, 256, 256), np.float32)
    inputs = {"camera": camera, "lidar": lidar, "ego_status": status}
    extra = {"wote": "sim_rewards", "diffusiondrive": "sub_scores"}[name]
    most = client.engine.card.sampler.size  # type: ignore[union-attr]
    asked: dict[str, Any] = {"num_samples": most, "seed": 0, "outputs": [extra]}
    alone = client.plan(inputs=inputs, **asked)
    asked["refine"] = {"route_drives": True}
    answer = client.plan(inputs={**inputs, "route": ROUTE}, **asked)
    assert len(answer.trajectories) == most
    assert (np.diff(answer.scores) <= 0).all()
    is_drive = (answer.arrays[extra] == 0).all(1)
    assert not (alone.arrays[extra] == 0).all(1).any()
    assert 8 <= is_drive.sum() < most
    ends = answer.trajectories[is_drive, -1, :2]
    assert (beside_route(ends, ROUTE) < 1.1).mean() > 0.6
    asked["num_samples"] = 1
    (one,) = client.plan(inputs={**inputs, "route": ROUTE}, **asked).trajectories
    np.testing.assert_array_equal(one, answer.trajectories[0])
    without = client.plan(inputs=inputs, **asked)  # no route: no drives
    np.testing.assert_array_equal(without.trajectories[0], alone.trajectories[0])


def test_a_planner_without_drives_refuses_them() -> None:
    client = LocalClient.of(BUNDLES / "goalflow", threads=1)
    status = ego_status(command="straight", velocity=(8.0, 0.0), acceleration=(0.0, 0.0))
    with pytest.raises(InvalidRequest, match=r"refine\.route_drives: expected none"):
        client.plan(inputs={"ego_status": status}, refine={"route_drives": True})
