"""Ways of cars: closed forms, arcs that meet their goals, and ways along a route."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from anchorflow_client.sensors import ROUTE_POINTS, ROUTE_SPACING_M
from anchorflow_models.goalflow import GoalFlow, GoalFlowConfig
from anchorflow_models.goalflow.config import ASIDE, HALTINGS, PACES
from anchorflow_models.goalflow.goalflow import POSE, SETTLED
from anchorflow_models.goalflow.ways import (
    FOLLOWS,
    GRIP,
    ROUTE_LEANING,
    ROUTE_SHARPEST,
    SHARPEST,
    arc_to,
    follows,
    is_told,
    roll_out,
    sharpest_at,
    strays_from,
    ways_along,
)

T, DT = 8, 0.5
TIMES = DT * torch.arange(1, T + 1)
ALONG = GoalFlowConfig().along
AHEAD = ROUTE_SPACING_M * torch.arange(ROUTE_POINTS)
STRAIGHT = torch.stack([AHEAD, torch.zeros_like(AHEAD)], -1)


def constant(value: float) -> Tensor:
    return torch.full((T,), value)


def test_a_straight_line_at_constant_acceleration() -> None:
    poses = roll_out(torch.tensor(5.0), constant(1.0), constant(0.0), dt=DT)

    torch.testing.assert_close(poses[:, 0], 5 * TIMES + 0.5 * TIMES**2)
    assert not poses[:, 1:].any()


def test_an_arc_at_constant_speed() -> None:
    poses = roll_out(torch.tensor(6.0), constant(0.0), constant(0.1), dt=DT)

    angle = 0.6 * TIMES
    torch.testing.assert_close(poses[:, 2], angle)
    torch.testing.assert_close(poses[:, 0], 10 * angle.sin(), atol=0.03, rtol=0)
    torch.testing.assert_close(poses[:, 1], 10 * (1 - angle.cos()), atol=0.03, rtol=0)


def test_who_brakes_stands_and_does_not_turn_back() -> None:
    poses = roll_out(torch.tensor(4.0), constant(-4.0), constant(0.0), dt=DT)

    assert poses[-1, 0].item() == pytest.approx(2.0, abs=0.05)
    assert (poses.diff(dim=0)[:, 0] >= 0).all()


@pytest.mark.parametrize("goal", [(30.0, 0.0), (25.0, 8.0), (20.0, -12.0), (10.0, 3.0), (3.0, 0.1)])
def test_an_arc_meets_its_goal(goal: tuple[float, float]) -> None:
    speed = torch.tensor(6.0)
    acceleration, curvature = arc_to(torch.tensor(goal), speed, duration=T * DT)
    poses = roll_out(speed, acceleration.expand(T), curvature.expand(T), dt=DT)

    assert math.dist(poses[-1, :2].tolist(), goal) < 0.25


def test_a_goal_behind_or_here_is_a_halt_not_a_nan() -> None:
    goals = torch.tensor([[0.0, 0.0], [-5.0, 0.0], [0.0, 5.0]], requires_grad=True)
    acceleration, curvature = arc_to(goals, torch.tensor([0.0, 8.0, 2.0]), duration=T * DT)
    (acceleration.sum() + curvature.sum()).backward()

    assert torch.isfinite(torch.stack([acceleration, curvature])).all()
    assert goals.grad is not None
    assert torch.isfinite(goals.grad).all()


def test_a_fast_car_bends_no_more_than_its_tyres_hold() -> None:
    speed = torch.tensor([0.0, 5.0, 20.0, 50.0])
    steady, slowing = (
        sharpest_at(speed, torch.full((4, T), pull), dt=DT).unbind(-1) for pull in (0.0, -2.0)
    )

    torch.testing.assert_close(
        steady[-1], torch.tensor([SHARPEST, SHARPEST, GRIP / 20**2, GRIP / 50**2])
    )
    torch.testing.assert_close(slowing[0], steady[0])
    torch.testing.assert_close(slowing[-1][2:], GRIP / torch.tensor([13.0, 43.0]).square())


def corner(before_m: float, radius_m: float) -> Tensor:
    """[ROUTE_POINTS, 2]: straight on, and round a corner of 90 degrees to the left."""
    place = 0.1 * torch.arange(round(ROUTE_SPACING_M * ROUTE_POINTS / 0.1))
    heading = ((place - before_m) / radius_m).clamp(0.0, 0.5 * torch.pi)
    fine = 0.1 * torch.stack([heading.cos(), heading.sin()], -1).cumsum(0)
    return fine[:: round(ROUTE_SPACING_M / 0.1)]


def moved(route: Tensor, left: float, turned: float) -> Tensor:
    """A route in the frame of a car that stands so far to its left, turned to the left."""
    places = route - torch.tensor([0.0, left])
    cos, sin = torch.tensor(turned).cos(), torch.tensor(turned).sin()
    return places @ torch.tensor([[cos, -sin], [sin, cos]])


def along(route: Tensor, speed: float, curvature: float = 0.0) -> tuple[Tensor, Tensor]:
    """Return one car's poses [W, T, 3] and controls [W, T, 2]."""
    now = torch.tensor([speed]), torch.tensor([curvature])
    poses, controls = ways_along(route[None], *now, steps=T, dt=DT)
    return poses[0], controls[0]


def strays_of(poses: Tensor, route: Tensor) -> Tensor:
    """[T] m of one trajectory [T, 3]."""
    return strays_from(poses[None, :, :2], route[None])[0]


def test_ways_go_on_at_each_pace_and_each_distance_from_the_route() -> None:
    poses, controls = along(STRAIGHT, 7.5)
    on_it, halts, beside_it = poses.split((len(PACES), len(HALTINGS), 2 * len(PACES)))
    going = torch.cat([on_it, beside_it])
    assert torch.allclose(halts[..., 1], torch.zeros(()), atol=1e-3)
    for halt, braking in zip(halts, HALTINGS, strict=True):
        assert halt[-1, 0] == pytest.approx(min(7.5**2 / 2 / braking, 18.0), abs=1.0)
    ends = going.unflatten(0, (len(ASIDE), len(PACES)))[..., -1, :]
    assert torch.allclose(ends[..., 1], torch.tensor(ASIDE)[:, None], atol=0.3)
    assert (ends[..., 0].diff(dim=1) >= 0).all()  # the faster the farther
    assert controls[..., 0].amax() <= 1.5 + 1e-4


@pytest.mark.parametrize(("left", "turned"), [(2.0, 0.0), (-3.0, 0.3), (0.5, -0.8)])
def test_who_stands_askew_comes_back_to_the_route(left: float, turned: float) -> None:
    route = moved(STRAIGHT, left, turned)
    poses, controls = along(route, 1.0)
    middle = poses[PACES.index(7.5)]
    assert strays_of(middle, route)[-1] < 0.4
    assert controls[..., 1].abs().amax() <= ROUTE_SHARPEST


def test_who_comes_out_of_a_corner_steers_back_no_faster_than_cars_do() -> None:
    poses, controls = along(STRAIGHT, 5.0, curvature=-0.2)
    bend = controls[PACES.index(5.0), :, 1]
    assert -0.2 < bend[0] < -0.05
    assert strays_of(poses[PACES.index(5.0)], STRAIGHT).amax() > 0.2
    assert strays_of(poses[PACES.index(5.0)], STRAIGHT)[-1] < 0.3


def test_a_corner_is_slowed_down_for() -> None:
    route = corner(15.0, 6.0)
    poses, controls = along(route, 10.0)
    fastest = poses[len(PACES) - 1]  # on the route itself
    assert fastest[-1, 2] > 0.3  # it is in the corner
    assert strays_of(fastest, route).amax() < 1.0
    speed = torch.cat([torch.zeros(1, 2), fastest[:, :2]]).diff(dim=0).norm(dim=-1) / DT
    leaning = speed.square() * controls[len(PACES) - 1, :, 1].abs()
    assert leaning.amax() < 2 * ROUTE_LEANING


def test_places_beside_a_route_and_beyond_its_ends() -> None:
    places = torch.tensor([[5.0, 2.0], [-4.0, -1.0], [90.0, 3.0]])
    assert torch.allclose(strays_of(places, STRAIGHT), torch.tensor([2.0, 1.0, 3.0]))


def test_what_ends_on_the_route_follows_it() -> None:
    ends = torch.tensor([[[9.0, 0.0], [9.0, FOLLOWS], [9.0, -50.0]]])
    told = follows(ends, STRAIGHT[None])[0]
    assert told.tolist() == pytest.approx([1.0, 0.5, 0.0], abs=2e-3)
    assert follows(ends, torch.zeros(1, ROUTE_POINTS, 2)).eq(1.0).all()


def test_one_place_forty_times_is_no_route() -> None:
    same = torch.tensor([5.0, 2.0]).expand(1, ROUTE_POINTS, 2)
    assert not is_told(same)
    assert is_told(STRAIGHT[None])
    assert follows(torch.tensor([[[9.0, -50.0]]]), same).eq(1.0).all()


def asked(batch: int) -> tuple[Tensor, Tensor, Tensor]:
    """A square that may be driven on everywhere, at 8 m/s."""
    bev = torch.zeros(batch, 20, 192, 128, dtype=torch.uint8)
    bev[:, 0] = 255
    status = torch.tensor([[0.0, 1, 0, 0, 8, 0, 0, 0]]).expand(batch, -1)
    return bev, status, torch.tensor([[4.6, 1.9]]).expand(batch, -1)


@pytest.fixture(params=[False, True], ids=["rules", "outcomes"])
def model(request: pytest.FixtureRequest) -> GoalFlow:
    torch.manual_seed(0)
    config = GoalFlowConfig(
        goals=64, picked=31, width=16, channels=8, feature_channels=4, outcomes=request.param
    )
    return GoalFlow(config).eval()


@torch.no_grad()
def test_of_two_scenes_one_may_be_told_a_route(model: GoalFlow) -> None:
    route = torch.stack([corner(10.0, 8.0), torch.zeros(ROUTE_POINTS, 2)])
    context = model.encode(*asked(2), route)
    told, untold = context["prior_mean"]
    assert torch.equal(untold, model.encode(*asked(1))["prior_mean"][0])
    once = model.config.ways - ALONG
    assert torch.equal(untold, untold[:once].repeat(2, 1, 1))  # as if it took no route
    # They alternate, so that four of nine anchors follow the route.
    by_turns = told[: 2 * ALONG]
    assert torch.equal(
        torch.cat([by_turns[::2], told[2 * ALONG : model.config.ways]]), untold[:once]
    )
    driven = by_turns[1::2]
    assert driven[..., POSE].eq(SETTLED).all()
    poses, controls = along(route[0], 8.0)
    assert torch.allclose(driven[..., :POSE], poses, atol=1e-5)
    assert torch.allclose(driven[..., POSE + 1 :], controls, atol=1e-5)


@torch.no_grad()
def test_who_knows_the_route_chooses_what_follows_it(model: GoalFlow) -> None:
    """On an empty plane that is all drivable, only the route distinguishes left from right."""
    left = corner(10.0, 8.0)
    for route in (left, left * torch.tensor([1.0, -1.0])):
        context = model.encode(*asked(1), route[None])
        mean = context["prior_mean"]
        scores = model.score(mean, mean, context)[0]
        best = mean[0, scores.argmax(), :, :POSE]
        assert strays_of(best, route)[-1] < FOLLOWS
        lost = (mean[0, :, -1, 1] * route[-1, 1].sign() < -5.0).nonzero()
        assert lost.numel()
        assert scores[lost].amax() < 0.1 * scores.amax()
