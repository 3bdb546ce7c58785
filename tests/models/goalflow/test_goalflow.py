"""GoalFlow's graphs in torch: their outputs, and independence of scenes and anchors."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from anchorflow_models.goalflow import GoalFlow, GoalFlowConfig
from anchorflow_models.goalflow.config import HALTINGS, TURNS
from anchorflow_models.goalflow.goalflow import LEANING, POSE, SETTLED, STATE, Context
from anchorflow_models.goalflow.ways import BRAKING, GRIP


def road(batch: int = 1) -> Tensor:
    """uint8 [B, C, H, W]: drivable from 4 m left to 4 m right."""
    bev = torch.zeros(batch, 20, 192, 128, dtype=torch.uint8)
    bev[:, 0, :, 56:72] = 255
    return bev


def statuses(*speeds: float) -> Tensor:
    return torch.tensor([[0, 1, 0, 0, speed, 0, 0, 0] for speed in speeds])


SIZE = torch.tensor([[4.6, 1.9]])
SETTLED_WAYS = 2 * len(TURNS) + len(HALTINGS)
ONCE = 7 + 1 + SETTLED_WAYS
"""Ways of a model without a route, before they repeat."""


@pytest.fixture(params=["mlp", "transformer"])
def model(request: pytest.FixtureRequest) -> GoalFlow:
    torch.manual_seed(0)
    config = GoalFlowConfig(
        goals=32, picked=7, backbone=request.param, width=32, channels=8, feature_channels=4
    )
    return GoalFlow(config).eval()


def sampled(model: GoalFlow, context: Context, noise: Tensor, *, steps: int) -> Tensor:
    """Euler steps from noise [N, 3T]: [B, N, T, S]."""
    components = context["prior_mean"]
    mean = components[:, torch.arange(len(noise)) % components.shape[1]]
    x = mean + (noise @ context["prior_basis"]).unflatten(-1, mean.shape[2:])
    for step in range(steps):
        modulation = model.modulate(torch.tensor([step / steps]), context)[:, 0]
        x = x + model.field(x, mean, modulation, context) / steps
    return x


@torch.no_grad()
def shaken(model: GoalFlow) -> GoalFlow:
    """Return a model with a field that is not zero."""
    for parameter in model.flow.parameters():
        parameter.add_(0.05 * torch.randn(parameter.shape))
    return model


@torch.no_grad()
def test_the_untrained_field_leads_from_noise_to_the_way(model: GoalFlow) -> None:
    context = model.encode(road(), statuses(8.0), SIZE)
    noise = torch.randn(model.config.ways, 24)
    for steps in (1, 4):
        x_1 = sampled(model, context, noise, steps=steps)
        torch.testing.assert_close(
            x_1, context["prior_mean"][:, : model.config.ways], atol=1e-4, rtol=0
        )


@torch.no_grad()
def test_goals_come_with_those_first_that_are_drawn_to(model: GoalFlow) -> None:
    context = model.encode(road(), statuses(8.0), SIZE)
    goals, scores = context["goals"][0], context["goal_scores"][0]

    assert sorted(map(tuple, goals.tolist())) == sorted(map(tuple, model.vocabulary.tolist()))
    assert (scores[7:].diff() <= 0).all()
    ways = model.ways_to(goals[None, :7], torch.tensor([8.0]))
    torch.testing.assert_close(context["prior_mean"][:, :7], ways)
    aimed = [1.0] * 7 + [0.0] + [SETTLED] * SETTLED_WAYS
    assert context["prior_mean"][0, :ONCE, 0, POSE].tolist() == aimed


@torch.no_grad()
@pytest.mark.parametrize("steps", [1, 3])
def test_a_goal_of_the_request_is_reached_by_controls_that_a_car_has(
    model: GoalFlow, steps: int
) -> None:
    shaken(model)
    model.takes_goals = True
    speeds, noise = (0.0, 6.0, 14.0), torch.randn(12, 24)
    goals = torch.tensor(
        [
            [[6.0, 2.0], [9.0, 0.0], [12.0, -3.0]],
            [[20.0, 5.0], [12.0, -2.0], [34.0, 0.0]],
            [[44.0, 8.0], [60.0, -4.0], [30.0, 1.0]],
        ]
    )
    inputs = (road(3), statuses(*speeds), SIZE.expand(3, -1))
    context = model.encode(*inputs, goal=goals)
    drawn = sampled(model, context, noise, steps=steps)
    missed = (drawn[:, :, -1, :2] - goals.repeat(1, 4, 1)).norm(dim=-1)
    assert missed.max() < 0.2
    moved = drawn[..., :2].diff(dim=2, prepend=torch.zeros(3, 12, 1, 2)).norm(dim=-1)
    first = (moved[..., 0] - 0.5 * torch.tensor(speeds)[:, None]).abs()
    assert first.max() < 0.5 * BRAKING * 0.5**2 + 0.05  # m: it leaves at its speed
    assert moved.diff(dim=-1).abs().max() < BRAKING * 0.5**2 + 0.05
    assert drawn[..., 0, 2].abs().max() < 0.5  # rad: and along x

    untold = [sampled(model, model.encode(*inputs), noise, steps=steps)]
    untold += [sampled(model, model.encode(*inputs, goal=0 * goals), noise, steps=steps)]
    model.takes_goals = False
    untold += [sampled(model, model.encode(*inputs), noise, steps=steps)]
    assert untold[0].shape == (3, 12, 8, STATE)
    assert all(torch.equal(each, untold[0]) for each in untold)


@torch.no_grad()
@pytest.mark.parametrize("speed", [0.0, 2.0, 14.0])
def test_turns_bend_to_both_sides_as_far_as_a_car_leans(model: GoalFlow, speed: float) -> None:
    ways = model.turns(torch.tensor([speed]))[0]
    acceleration, curvature = ways[..., POSE + 1 :].unbind(-1)
    times = 0.5 * torch.arange(1, 9)
    fast = speed + acceleration * times

    assert ways.shape[0] == 2 * len(TURNS)
    torch.testing.assert_close(ways[0::2, :, 1:3], -ways[1::2, :, 1:3])
    assert (ways[0::2, -1, 1] > 0).all()
    assert (curvature.abs() <= torch.tensor([b for b, _ in TURNS for _ in range(2)])[:, None]).all()
    assert (fast.square() * curvature.abs()).amax() <= LEANING + 1e-3
    if speed < 3:  # from a walk the sharpest turns come round within four seconds
        for number, (bend, to) in enumerate(TURNS):
            assert fast[2 * number, -1] == pytest.approx(to, abs=1e-4)
            if bend * to >= 1:
                assert ways[2 * number, -1, 2] > 1.0


@torch.no_grad()
def test_halts_brake_until_they_stand_whatever_the_flow_says(model: GoalFlow) -> None:
    context = shaken(model).encode(road(), statuses(6.0), SIZE)
    drawn = sampled(model, context, torch.randn(model.config.ways, 24), steps=2)
    halts = drawn[0, ONCE - len(HALTINGS) : ONCE, :, :POSE]
    expected = torch.tensor([6.0**2 / (2 * braking) for braking in HALTINGS])
    # Steps of an eighth of a second; the gentlest stands after four of them.
    torch.testing.assert_close(halts[:, -1, 0], expected, atol=0.1, rtol=0)
    assert (halts[:, -1] - halts[:, -2]).abs().amax() < 0.3
    assert halts[..., 1:].abs().amax() < 1e-6
    moved = (drawn[0, :ONCE] - context["prior_mean"][0, :ONCE])[..., :POSE].abs().amax((1, 2))
    assert (moved[:-SETTLED_WAYS] > 0.01).all()
    assert (moved[-SETTLED_WAYS:] < 1e-4).all()


@torch.no_grad()
def test_scenes_and_anchors_hear_no_others(model: GoalFlow) -> None:
    shaken(model)
    bev = torch.cat([road(), torch.randint(0, 255, (2, 20, 192, 128), dtype=torch.uint8)])
    status, size, noise = statuses(8.0, 3.0, 12.0), SIZE.expand(3, -1), torch.randn(9, 24)
    context = model.encode(bev, status, size)
    together = sampled(model, context, noise, steps=2)
    mean = context["prior_mean"][:, torch.arange(9) % model.config.ways]
    scores = model.score(together, mean, context)
    for scene in range(3):
        own = slice(scene, scene + 1)
        alone = model.encode(bev[own], status[own], size[own])
        x_1 = sampled(model, alone, noise, steps=2)
        torch.testing.assert_close(x_1, together[own], atol=1e-4, rtol=1e-4)
        first = sampled(model, alone, noise[:3], steps=2)
        torch.testing.assert_close(first, together[own, :3], atol=1e-4, rtol=1e-4)
        of_first = model.score(first, alone["prior_mean"][:, :3], alone)
        torch.testing.assert_close(of_first, scores[own, :3], atol=1e-5, rtol=1e-3)


@torch.no_grad()
def test_every_answer_starts_at_the_present_speed(model: GoalFlow) -> None:
    shaken(model)
    context = model.encode(road(), statuses(10.0), SIZE)
    x_1 = sampled(model, context, torch.randn(8, 24), steps=3)

    # 0.5 s at 10 m/s, pulling or braking at no more than a car can; a bend shortens the chord.
    first = x_1[0, :, 0, :2].norm(dim=-1)
    assert ((first > 4.1) & (first < 5.0 + 0.3)).all()


@torch.no_grad()
def test_a_fast_car_is_drawn_no_circles(model: GoalFlow) -> None:
    shaken(model)
    context = model.encode(road(), statuses(40.0), SIZE)
    x_1 = sampled(model, context, torch.randn(64, 24), steps=1)

    aimed = context["prior_mean"][0, torch.arange(64) % model.config.ways, 0, POSE] >= 0
    turned = x_1[0, aimed, :, 2].diff(dim=-1).abs()
    assert aimed.sum() > 20
    slowest = 16.0  # m/s, after braking for four seconds
    assert turned.amax() < 0.5 * GRIP / slowest


@torch.no_grad()
def test_a_box_in_the_way_and_a_road_that_ends_cost_score(model: GoalFlow) -> None:
    def score(bev: Tensor) -> float:
        context = model.encode(bev, statuses(10.0), SIZE)
        way = model.ways_to(torch.tensor([[[40.0, 0.0]]]), context["speed"])
        return float(model.score(way, way, {**context, **blind}))

    blind = {name: model.encode(road(), statuses(10.0), SIZE)[name] for name in ("features",)}
    blind["context"] = model.encode(road(), statuses(10.0), SIZE)["context"]
    free = score(road())
    parked, gone, ends = road(), road(), road()
    parked[:, 11:, 90:110, 60:68] = 255  # 25 to 35 m ahead, at all times
    gone[:, 11, 90:110, 60:68] = 255  # there in 0.5 s and no later
    ends[:, 0, :100] = 0  # beyond 30 m
    assert score(gone) == pytest.approx(free, rel=1e-3)
    assert score(parked) < 0.05 * free
    assert score(ends) < 0.05 * free
