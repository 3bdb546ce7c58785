"""The clearance of a place, in the planner and in the service, and a start with too little."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from staged_planner import Stage, nothing_safe

from anchorflow_client import CostMap
from anchorflow_client.planner import PlannerConfig
from anchorflow_client.planner.local_goal import SHARE_OF_CELL, start_clearance
from anchorflow_trajectory.cost.clearance import GridField, clearance_field
from anchorflow_trajectory.finish import certificate as verify

RADIUS, CELL = 0.25, 0.1
NEAREST_CENTRE = np.sqrt(0.5) - 0.5  # cells by which its square may be further than another


@given(
    seed=st.integers(0, 2**32 - 1),
    share=st.sampled_from([0.0, 0.02, 0.3]),
    place=st.tuples(st.floats(-1.6, 1.6), st.floats(-1.2, 1.2)),
)
def test_it_is_the_services_or_a_little_less(
    seed: int, share: float, place: tuple[float, float]
) -> None:
    occupied = np.random.default_rng(seed).random((24, 32)) < share
    cost_map = CostMap.build(occupied[None].astype(np.float32), CELL)
    own = start_clearance(cost_map, np.array(place), RADIUS)
    values = clearance_field(occupied, CELL, RADIUS)
    field = GridField(values, CELL, cost_map.origin.astype(np.float32))
    asked = float(field.sample(*np.array(place, np.float32)))

    # The service takes the square whose centre is nearest. If the map's edge is as near as an
    # obstacle, the lesser of the two is below either between the centres.
    assert own - CELL < asked < own + NEAREST_CENTRE * CELL + 1e-5


def test_the_share_of_a_cell_is_the_services_and_a_full_map_has_no_clearance() -> None:
    assert SHARE_OF_CELL == verify.SHARE_OF_CELL
    assert start_clearance(CostMap.build(np.ones((1, 24, 32)), CELL), np.zeros(2), RADIUS) < 0.0


def beside_a_wall(stage: Stage, clearance: float, **options: Any) -> float | None:
    """Return the certified margin of the request of a robot that far (m) from a wall."""
    data = np.zeros((64, 64))
    data[32] = 1.0  # y from 0 to 0.1
    start = [0.05, 0.1 + RADIUS + clearance, 0.0, 0.0, 0.0, 0.0]
    stage.cycle(
        cost_map=data,
        resolution=CELL,
        x_curr=start,
        x_goal=[1.0, 1.0, 0.0, 0.0],
        robot_radius=RADIUS,
        **options,
    )
    refine = stage.requests[-1].refine
    return refine and refine.certified_margin


@pytest.mark.parametrize(
    ("clearance", "margin"),
    [(0.2, 0.05), (0.082, 0.05), (0.077, 0.046), (0.05, 0.019), (0.02, 0.0), (-0.1, 0.0)],
)
def test_a_robot_near_an_obstacle_requests_the_margin_that_it_has(
    clearance: float, margin: float
) -> None:
    sent = beside_a_wall(Stage(PlannerConfig(margin_m=0.05)), clearance)

    assert sent == pytest.approx(margin, abs=1e-6)


def test_the_requests_own_margin_is_sent_as_it_is() -> None:
    stage = Stage(PlannerConfig(margin_m=0.05))
    assert beside_a_wall(stage, 0.02, refine={"certified_margin": 0.1}) == 0.1
    assert beside_a_wall(Stage(PlannerConfig()), 0.02) is None


def test_the_reason_names_a_start_that_is_too_near() -> None:
    stage = Stage(PlannerConfig(margin_m=0.05))
    stage.reply = nothing_safe
    beside_a_wall(stage, 0.02)
    plan = stage.planner.wait(0.0)
    assert plan.reason is not None
    assert "the start keeps 0.020 m of the 0.050 m that are asked for and 0.030 m" in plan.reason

    beside_a_wall(stage, 0.3)
    plan = stage.planner.wait(0.0)
    assert plan.reason is not None
    assert "start" not in plan.reason
