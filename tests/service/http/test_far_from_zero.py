"""A scene in UTM coordinates is answered as the same scene at home, whatever carries it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from served import TRANSPORTS, client_over

from anchorflow_client import AnchorBatch
from anchorflow_client.base_client import BaseClient
from anchorflow_service.bundle import DEFAULT_BUNDLE
from anchorflow_service.local import LocalClient
from anchorflow_service.planning import PlanningService

UTM = np.array([689123.4, 5400321.7])
START, GOAL = np.array([0.6, 0.7]), np.array([9.2, 9.0])  # m from the corner
CLOSE = 5e-3  # m


@pytest.fixture(scope="module")
def engine() -> Any:
    return LocalClient.of(DEFAULT_BUNDLE.parent / "student", threads=2).engine


@pytest.fixture(params=TRANSPORTS)
def client(request: pytest.FixtureRequest, engine: Any) -> Iterator[BaseClient]:
    planning = PlanningService({engine.card.name: engine}, default=engine.card.name)
    with client_over(request.param, planning) as client:
        yield client


def plan(client: BaseClient, place: np.ndarray, **changes: Any) -> AnchorBatch:
    """The same clutter, wherever the corner of its map lies."""
    draw = np.random.default_rng(4)
    occupancy = np.zeros((1, 64, 64), np.float32)
    for row, column in draw.integers(8, 52, (14, 2)):
        occupancy[0, row : row + 5, column : column + 5] = 1.0
    return client.plan(
        cost_map=occupancy,
        resolution=0.16,
        origin=place,
        x_curr=[*(place + START), 0.4, 0.2, 0.0, 0.0],
        x_goal=[*(place + GOAL), 0.0, 0.0],
        seed=3,
        **changes,
    )


@pytest.mark.parametrize(
    ("corner", "beside"),
    [(0.0, None), (-5.12, "warm_start"), (-5.12, "obstacles")],
    ids=["from the corner", "centred, warm", "centred, with a person"],
)
def test_the_same_scene_in_utm_coordinates_is_answered_as_at_home(
    client: BaseClient, corner: float, beside: str | None
) -> None:
    def asked_at(place: np.ndarray) -> AnchorBatch:
        line = place + np.round(np.linspace(START, GOAL, 20), 3)
        person = {"position": [line[6]], "radius": [0.3], "forecast": [line[10:12]]}
        given = {
            "warm_start": {"trajectory": line},
            "obstacles": person | {"forecast_dt": 6.0},  # slow: its first place counts, too
        }
        return plan(client, place, **{name: given[name] for name in given if name == beside})

    home, far = asked_at(np.full(2, corner)), asked_at(UTM + corner)

    assert home.trajectories.dtype == np.float32
    assert far.trajectories.dtype == np.float64
    np.testing.assert_allclose(far.trajectories - UTM, home.trajectories, atol=CLOSE)
    np.testing.assert_allclose(far.velocities, home.velocities, atol=CLOSE)
    np.testing.assert_array_equal(far.safe, home.safe)
    assert home.safe.any()


def test_a_resolution_that_float32_rounds_refuses_no_goal(client: BaseClient) -> None:
    """A goal in the last cell of a map of 0.7 m cells is on the map for both ends of the wire."""
    upper = 689123.4 + 16 * 0.7
    anchors = client.plan(
        cost_map=np.zeros((1, 16, 16), np.float32),
        resolution=0.7,
        origin=[689123.4, 0.0],
        x_curr=[689124.0, 5.0, 0.0, 0.0, 0.0, 0.0],
        x_goal=[upper - 1e-6, 5.0, 0.0, 0.0],
        num_samples=2,
    )

    assert anchors.trajectories[0, -1, 0] == pytest.approx(upper, abs=1e-3)
