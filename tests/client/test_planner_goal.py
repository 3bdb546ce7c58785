"""Local goals on the map and beyond it, and the clearance of a place and of a start."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from staged_planner import ByHand, Stage, batch_for, nothing_safe

from anchorflow_client import (
    CostMap,
    InvalidRequest,
    ModelCard,
    Unauthorized,
)
from anchorflow_client.contract.card import TensorsSpec
from anchorflow_client.planner import Planner, PlannerConfig
from anchorflow_client.planner.local_goal import (
    SHARE_OF_CELL,
    local_goal,
    obstacle_distance,
    start_clearance,
)
from anchorflow_trajectory.cost.clearance import GridField, clearance_field
from anchorflow_trajectory.finish import certificate as verify

RESOLUTION = 0.25
HERE = np.zeros(2)


def empty_map() -> np.ndarray:
    """Return [1,H,W], 8 m by 8 m round (0, 0)."""
    return np.zeros((1, 32, 32), np.float32)


def goal_on(data: np.ndarray, goal: list[float], clearance_m: float = 0.3) -> np.ndarray:
    return local_goal(
        CostMap.build(data, RESOLUTION),
        HERE,
        np.array(goal),
        clearance_m=clearance_m,
        through_speed=1.5,
    )


SLANT = 1.5 / np.sqrt(5)


@pytest.mark.parametrize(
    ("goal", "expected"),
    [
        ([2.1, -1.3, 0.4, 0.2], [2.1, -1.3, 0.4, 0.2]),
        ([30.0, 0.0, 0.0, 0.0], [3.7, 0.0, 1.5, 0.0]),  # passed, inside the map
        ([20.0, 10.0, 0.0, 0.0], [3.7, 1.85, 2 * SLANT, SLANT]),
        ([30.0, 0.0, 0.7, 0.0, 0.0, 0.1], [3.7, 0.0, 0.7, 1.5, 0.0, 0.1]),  # keeps its heading
    ],
)
def test_a_goal_on_a_free_map_is_kept_or_cut_off_at_its_edge(
    goal: list[float], expected: list[float]
) -> None:
    np.testing.assert_allclose(goal_on(empty_map(), goal), expected, atol=1e-9)


def test_a_goal_in_an_obstacle_moves_to_the_nearest_free_cell_and_is_stopped_at() -> None:
    data = empty_map()
    data[0, 12:20, 20:28] = 1.0  # x from 1 to 3, y from -1 to 1
    goal = goal_on(data, [1.2, 0.1, 0.0, 0.0], clearance_m=0.3)

    # The last column of cells before the wall whose centre is more than 0.3 m from its first.
    np.testing.assert_allclose(goal, [0.625, 0.125, 0.0, 0.0], atol=1e-9)


def test_a_map_without_room_is_refused() -> None:
    with pytest.raises(InvalidRequest, match=r"cost_map\.data: expected a cell that is 0\.3 m"):
        goal_on(np.ones((1, 16, 16)), [1.0, 0.0, 0.0, 0.0])


@given(
    seed=st.integers(0, 2**32 - 1),
    share=st.floats(0.0, 0.3),
    goal=st.tuples(st.floats(-50, 50), st.floats(-50, 50)),
    clearance_m=st.floats(0.0, 0.6),
)
def test_the_local_goal_keeps_its_distance(
    seed: int, share: float, goal: tuple[float, float], clearance_m: float
) -> None:
    occupied = np.random.default_rng(seed).random((32, 32)) < share
    data = occupied[None].astype(np.float32)
    try:
        point = goal_on(data, [*goal, 0.0, 0.0], clearance_m)[:2]
    except InvalidRequest:
        return
    assert (np.abs(point) <= 4.0 - clearance_m + RESOLUTION).all()
    rows, columns = np.nonzero(occupied)
    centres = RESOLUTION * (np.stack([columns, rows], axis=1) + 0.5) - 4.0
    # The point is at most half a diagonal from its cell's centre, which was checked.
    distance = np.linalg.norm(centres - point, axis=1).min(initial=np.inf)
    assert distance >= clearance_m - RESOLUTION / np.sqrt(2) - 1e-9


class Carded(Stage):
    """A stage whose client has cards, too."""

    def __init__(self, *cards: ModelCard, lost: bool = False) -> None:
        super().__init__(PlannerConfig(through_speed=1.0))
        self.cards, self.lost = cards, lost
        self.fetched = 0

    def models(self) -> tuple[ModelCard, ...]:
        self.fetched += 1
        if self.lost:
            raise Unauthorized("not for you")
        return self.cards


def through_speed(stage: Stage, **options: Any) -> float:
    """Return m/s at the local goal of one beyond the map."""
    stage.cycle(x_goal=[50.0, 0.0, 0.0, 0.0], **options)
    return round(float(np.linalg.norm(stage.requests[-1].x_goal[0, 2:])), 9)


def slow(card: ModelCard, v_max: float) -> ModelCard:
    limits = replace(card.cost_map.limits, v_max=v_max)
    return replace(card, conditioning=replace(card.cost_map, limits=limits))


def test_a_far_goal_is_passed_no_faster_than_the_robot_drives(
    stage: Stage, card: ModelCard
) -> None:
    assert through_speed(stage) == 1.0
    assert through_speed(stage, v_max=0.26) == 0.26
    assert through_speed(stage, v_max=2.0) == 1.0

    carded = Carded(slow(card, 0.5), replace(slow(card, 0.3), name="crawler"))
    assert [through_speed(carded) for _ in range(2)] == [0.5, 0.5]
    assert through_speed(carded, model="crawler") == 0.3
    assert carded.fetched == 1
    assert through_speed(carded, model="crawler", v_max=0.8) == 0.8
    assert through_speed(Carded(card)) == 1.0


def test_without_a_card_a_far_goal_is_passed_as_it_is_set(card: ModelCard) -> None:
    tensors = replace(card, conditioning=TensorsSpec())
    for stage in (Carded(), Carded(tensors), Carded(card, lost=True)):
        assert through_speed(stage) == 1.0


def test_a_goal_in_a_pocket_is_not_taken_where_another_place_can_be_reached() -> None:
    data = empty_map()
    data[0, 8:24, 22] = data[0, 8:24, 29] = data[0, 8, 22:30] = data[0, 23, 22:30] = 1.0

    def reached(passage_m: float) -> np.ndarray:
        cost_map = CostMap.build(data, RESOLUTION)
        goal = np.array([2.5, 0.0, 0.0, 0.0])
        return local_goal(
            cost_map, HERE, goal, clearance_m=0.3, through_speed=1.5, passage_m=passage_m
        )

    assert reached(0.3)[0] < 1.5 or abs(reached(0.3)[1]) > 2.0  # outside the pocket
    data[0, 14:18, 22] = 0.0  # a door of 1 m
    np.testing.assert_array_equal(reached(0.3), [2.5, 0.0, 0.0, 0.0])
    assert reached(0.8)[0] != 2.5  # too narrow for a wider robot


@given(seed=st.integers(0, 2**32 - 1), goal=st.tuples(st.floats(-6, 6), st.floats(-6, 6)))
def test_the_local_goal_keeps_the_clearance_that_the_service_requires(
    seed: int, goal: tuple[float, float]
) -> None:
    data = (np.random.default_rng(seed).random((1, 32, 32)) < 0.05).astype(np.float32)
    data[0, 12:20, 12:20] = 0.0
    stage = Carded()
    stage.planner = Planner(
        stage,
        PlannerConfig(goal_clearance_m=0.0, margin_m=0.05),
        executor=ByHand(stage.waiting),
    )
    stage.cycle(cost_map=data, resolution=RESOLUTION, x_goal=[*goal, 0, 0], robot_radius=0.2)
    sent = stage.requests[-1]
    distance = obstacle_distance(CostMap.build(data, RESOLUTION), sent.x_goal[0, :2])

    assert distance >= 0.2 + 0.05 + SHARE_OF_CELL * RESOLUTION


def test_the_cards_radius_is_the_default(card: ModelCard) -> None:
    data = np.zeros((64, 64), np.float32)
    data[31:33, 40:] = 1.0  # the goal lies 0.3 m beside it
    wide = replace(card.cost_map, limits=replace(card.cost_map.limits, robot_radius=0.5))
    for cards, own, kept in (
        ((replace(card, conditioning=wide),), None, 0.5),
        ((replace(card, conditioning=wide),), 0.4, 0.4),
        ((), None, 0.3),
    ):
        stage = Carded(*cards)
        stage.cycle(cost_map=data, resolution=0.1, x_goal=[1.5, 0.4, 0, 0], robot_radius=own)
        goal = stage.requests[-1].x_goal[0]
        assert kept <= obstacle_distance(CostMap.build(data[None], 0.1), goal[:2]) < kept + 0.2


def test_a_body_needs_its_inner_radius_and_any_heading_on_the_way(card: ModelCard) -> None:
    stage = Carded(card)
    long = [[-0.6, -0.2], [0.6, -0.2], [0.6, 0.2], [-0.6, 0.2]]
    body = {"footprint": long, "kinematics": {"kind": "differential"}}
    data = np.zeros((64, 64), np.float32)
    data[31:33, 40:] = 1.0
    for goal, tolerance in ((-1.5, None), (30.0, 0.3)):
        stage.cycle(
            cost_map=data,
            resolution=0.1,
            x_curr=[0.0] * 9,
            x_goal=[goal, 0.4, 1.0, 0, 0, 0],
            **body,
        )
        sent = stage.requests[-1]
        assert sent.warm_start is None
        assert sent.footprint is not None
        assert (sent.goal_tolerance and sent.goal_tolerance.position) == tolerance
        assert sent.goal_tolerance is None or sent.goal_tolerance.heading is None
    stage.cycle(
        cost_map=data,
        resolution=0.1,
        x_curr=[0.0] * 9,
        x_goal=[1.5, 0.4, 1.0, 0, 0, 0],
        **body,
    )
    goal = stage.requests[-1].x_goal[0, :2]
    assert 0.2 <= obstacle_distance(CostMap.build(data[None], 0.1), goal) < 0.4


def test_after_an_unsafe_answer_the_robot_stops_at_a_local_goal(stage: Stage) -> None:
    assert through_speed(stage) == 1.0
    stage.reply = nothing_safe
    assert through_speed(stage) == 1.0
    stage.reply = batch_for
    assert [through_speed(stage) for _ in range(2)] == [0.0, 0.0]

    assert through_speed(stage, x_curr=[0.9, 0, 0, 0, 0, 0]) == 0.0
    assert through_speed(stage, x_curr=[1.1, 0, 0, 0, 0, 0]) == 1.0


def goal_from(data: np.ndarray, y: float, goal_y: float, *, clearance_m: float) -> np.ndarray:
    """Return [2] m, the local goal of a robot that needs 0.3 m."""
    cost_map, here, goal = CostMap.build(data, 0.1), np.array([0.0, y]), [0.0, goal_y, 0.0, 0.0]
    return local_goal(
        cost_map, here, np.array(goal), clearance_m=clearance_m, through_speed=1.0, passage_m=0.3
    )[:2]


def test_a_place_across_a_wall_is_not_reached() -> None:
    data = np.zeros((1, 64, 64), np.float32)
    data[0, 21:32] = 1.0  # y from -1.1 to 0
    data[0, 22:32, 30:34] = 0.0  # a niche that opens upwards; below it is a wall of one cell

    assert goal_from(data, -0.7, 2.0, clearance_m=0.35)[1] == 2.0
    assert 0.0 < goal_from(data, -0.7, -2.0, clearance_m=0.35)[1] < 0.5


def test_a_corridor_without_a_free_cell_is_driven_along() -> None:
    data = np.zeros((1, 64, 64), np.float32)
    data[0, 4:60, 28] = data[0, 4:60, 36] = 1.0  # 0.7 m wide
    data[0, 59, 28:37] = data[0, 4, 28:37] = 1.0

    x, y = goal_from(data, 0.05, 3.0, clearance_m=0.6)
    assert -0.3 < x < 0.4
    assert 2.0 < y < 2.7


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
