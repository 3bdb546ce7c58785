"""The clearance of a place, as the planner and as the service measure it; a start too near."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from staged_planner import Stage, batch_for

from anchorflow_client import AnchorBatch, AnchorRequest, CostMap
from anchorflow_client.planner import PlannerConfig
from anchorflow_client.planner.local_goal import SHARE_OF_CELL, start_clearance
from anchorflow_trajectory import verify
from anchorflow_trajectory.clearance import GridField, clearance_field

RADIUS, CELL = 0.25, 0.1
NEAREST_CENTRE = np.sqrt(0.5) - 0.5  # of a cell, that its square lies further than another at most


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

    # The service takes the square whose centre is nearest. Where the map's edge is as near as an
    # obstacle, the lesser of the two lies below either in between the centres.
    assert own - CELL < asked < own + NEAREST_CENTRE * CELL + 1e-5


def test_on_a_map_without_free_ground_there_is_none() -> None:
    assert start_clearance(CostMap.build(np.ones((1, 24, 32)), CELL), np.zeros(2), RADIUS) < 0.0


def test_what_the_service_asks_for_beyond_the_margin_is_known() -> None:
    assert SHARE_OF_CELL == verify.SHARE_OF_CELL


def beside_a_wall(stage: Stage, clearance: float, **options: Any) -> float | None:
    """The certified margin that is sent for a robot so many metres from a wall."""
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
def test_a_robot_too_near_an_obstacle_asks_for_the_margin_that_it_has(
    clearance: float, margin: float
) -> None:
    sent = beside_a_wall(Stage(PlannerConfig(margin_m=0.05)), clearance)

    assert sent == pytest.approx(margin, abs=1e-6)


def test_the_requests_own_margin_is_sent_as_it_is() -> None:
    stage = Stage(PlannerConfig(margin_m=0.05))
    assert beside_a_wall(stage, 0.02, refine={"certified_margin": 0.1}) == 0.1
    assert beside_a_wall(Stage(PlannerConfig()), 0.02) is None


def test_the_reason_names_a_start_that_is_too_near() -> None:
    def nothing_safe(request: AnchorRequest) -> AnchorBatch:
        batch = batch_for(request)
        return replace(batch, arrays={**batch.arrays, "safe": np.zeros(2, bool)})

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
