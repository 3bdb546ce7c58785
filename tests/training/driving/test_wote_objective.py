"""The losses of WoTE, each against what the hand works out."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from tiny_wote import TINY, sensors, tiny_wote
from torch import Tensor
from training_runs import descended

from anchorflow_models.wote import WoTE, WoteConfig
from anchorflow_training.driving.labels import CLASSES
from anchorflow_training.driving.losses import (
    agent_loss,
    distances,
    focal_loss,
    likeness_loss,
    match,
    occupancy_loss,
)
from anchorflow_training.driving.wote_objective import (
    VEHICLE,
    WoteObjective,
    WoteObjectiveConfig,
    likely,
    with_ego,
)

TOLD = replace(
    TINY,
    encounters=((0.0, 0.0),),
    driven=True,
    backbone=replace(TINY.backbone, lidar_before=True, lidar_size=64),
)


def batch(config: WoteConfig = TINY, B: int = 2) -> dict[str, Tensor]:
    generator = torch.Generator().manual_seed(3)
    rows, columns = config.backbone.semantic_size
    classes = torch.randint(0, config.semantic_classes, (2, B, rows, columns), generator=generator)
    driven = tiny_wote(config).anchors[[3, 7]]
    cells, size = config.backbone.upscaled_size, config.backbone.lidar_size
    others = {
        "lidar_randomised": torch.rand(B, 1, size, size, generator=generator),
        "agent_velocity": torch.ones(B, config.agents, 2),
        "randomised_velocity": -torch.ones(B, config.agents, 2),
        "far_others": torch.tensor([40.0, 0.0, 0.0, 9.0, 9.0]).expand(B, 1, -1),
        "far_velocity": torch.ones(B, 1, 2),
        "far_count": torch.ones(B),
    }
    return {
        **sensors(config, B),
        **(others if config.encounters else {}),
        "future": driven + torch.tensor([0.2, 0.1, 0.0]),
        "is_example": torch.ones(B),
        "is_recorded": torch.ones(B),
        "pdm": torch.rand(B, config.anchors, 5, generator=generator),
        "agents": 10 * torch.rand(B, config.agents, 5, generator=generator),
        "agent_count": torch.tensor([3, 0]),
        "semantics": classes[0],
        "future_semantics": classes[1],
        "occupancy": (
            torch.rand(B, config.num_steps, cells, cells, generator=generator) < 0.2
        ).byte(),
    }


def test_the_loss_is_the_weighted_sum_of_its_terms() -> None:
    config = WoteObjectiveConfig(semantics=3.0, future_semantics=0.0, occupancy=2.0)
    objective = WoteObjective(tiny_wote(), config)
    loss, terms = objective(batch(), *objective.draw(2, 1, torch.Generator()))
    assert set(terms) == {
        "offset",
        "offset_imitation",
        "imitation",
        "simulation",
        "agents",
        "semantics",
        "future_semantics",
        "occupancy",
    }
    wanted = sum(getattr(config, name) * term for name, term in terms.items())
    torch.testing.assert_close(loss, torch.as_tensor(wanted))


@pytest.mark.parametrize("config", [TINY, TOLD], ids=["published", "told of others"])
def test_every_weight_is_reached(config: WoteConfig) -> None:
    model = tiny_wote(config).train()
    objective = WoteObjective(model, WoteObjectiveConfig())
    loss, terms = objective(batch(config), *objective.draw(2, 1, torch.Generator().manual_seed(0)))
    assert ({"motion", "far"} <= set(terms)) is bool(config.encounters)
    loss.backward()
    missed = [name for name, weight in model.named_parameters() if weight.grad is None]
    assert missed == []


def test_steps_make_every_term_smaller() -> None:
    model, given = tiny_wote().train(), batch()
    objective = WoteObjective(model, WoteObjectiveConfig(occupancy=1.0))
    drawn = objective.draw(2, 1, torch.Generator().manual_seed(0))
    first, *_, last = descended(objective, given, drawn, steps=20)
    # Random numbers say nothing of what soft labels and rewards could fall to.
    for name in first:
        assert last[name] < first[name], name
    assert last["offset"] < 0.5 * first["offset"]


def test_a_semantic_target_has_the_ego_where_an_anchor_ends() -> None:
    """A box of 5.176 by 2.297 m, 1.46 m of it behind the rear axle."""
    cell, street = 0.125, torch.ones(2, 256, 512, dtype=torch.uint8)
    ends = torch.tensor([[[20.0, -6.0, 0.0], [10.0, 8.0, torch.pi / 2]], [[-9.0, 0, 0]] * 2])
    drawn = with_ego(street, ends, reach=32.0)
    assert drawn.shape == (2, 2, 256, 512)
    area = cell**2 * (drawn == VEHICLE).sum((-1, -2))
    torch.testing.assert_close(area[0], torch.full((2,), 5.176 * 2.297), atol=1.0, rtol=0)
    assert area[1].tolist() == [0.0, 0.0]  # behind what is seen
    rows, columns = (drawn[0, 0] == VEHICLE).nonzero().float().mean(0)
    assert 32.0 - cell * (rows + 0.5) == pytest.approx(20.0 + 5.176 / 2 - 1.461, abs=0.3)
    assert 32.0 - cell * (columns + 0.5) == pytest.approx(-6.0, abs=0.3)
    rows, columns = (drawn[0, 1] == VEHICLE).nonzero().float().mean(0)
    assert 32.0 - cell * (columns + 0.5) == pytest.approx(8.0 + 5.176 / 2 - 1.461, abs=0.3)


def test_several_anchors_learn_what_follows_from_them() -> None:
    config = replace(
        TINY,
        semantic_classes=len(CLASSES),
        shared_future=True,
        rewards_of_all_steps=True,
        future_steps=2,
    )
    model, given = tiny_wote(config).train(), batch(config)
    told = WoteObjectiveConfig(future_anchors=3, judged=5, future_semantics=1.0)
    objective = WoteObjective(model, told)
    drawn = objective.draw(2, 1, torch.Generator().manual_seed(0))
    loss, terms = objective(given, *drawn)
    loss.backward()
    missed = [name for name, weight in model.named_parameters() if weight.grad is None]
    assert missed == []
    alone = WoteObjective(model, replace(told, future_anchors=1))
    assert alone(given, *drawn)[1]["future_semantics"] != terms["future_semantics"]
    first, *_, last = descended(objective, given, drawn, steps=10)
    assert last["future_semantics"] < first["future_semantics"]


def test_some_anchors_are_judged_the_nearest_first() -> None:
    objective = WoteObjective(tiny_wote(), WoteObjectiveConfig(judged=4))
    order = torch.rand(2, 12, generator=torch.Generator().manual_seed(0))
    nearest, ranked = torch.tensor([3, 7]), torch.arange(12).expand(2, -1)
    chosen = objective._chosen(order, nearest, ranked)
    assert chosen.shape == (2, 4)
    assert chosen[:, 0].tolist() == [3, 7]
    assert all(len(set(row)) == 4 for row in chosen.tolist())
    # The likeliest follow; one of them may be the nearest.
    half = WoteObjective(tiny_wote(), WoteObjectiveConfig(judged=6, likely=3))
    chosen = half._chosen(order, nearest, ranked + 1).tolist()
    assert [set(row[:3]) for row in chosen] == [{3, 1, 2}, {7, 1, 2}]
    assert [len(set(row)) for row in chosen] == [6, 6]
    # The loss of all anchors in any order is one loss.
    whole = WoteObjective(tiny_wote(), WoteObjectiveConfig())
    with torch.no_grad():
        one, other = (whole(batch(), each, order)[0] for each in (order, order.flip(1)))
    torch.testing.assert_close(one, other)


def test_without_offsets_they_are_not_learnt() -> None:
    objective = WoteObjective(tiny_wote(replace(TINY, offsets=False)), WoteObjectiveConfig())
    _, terms = objective(batch(), *objective.draw(2, 1, torch.Generator()))
    assert "offset" not in terms
    assert "offset_imitation" not in terms


def test_rewards_may_be_learnt_as_they_count() -> None:
    """EP, TTC and C of what passes alone, and the order of anchors beside."""
    config = WoteObjectiveConfig(conditional=True, rank=2.0)
    objective, given = WoteObjective(tiny_wote(), config), batch()
    drawn = objective.draw(2, 1, torch.Generator())
    given["pdm"] = given["pdm"].round()
    loss, terms = objective(given, *drawn)
    wanted = sum(getattr(config, name) * term for name, term in terms.items())
    torch.testing.assert_close(loss, torch.as_tensor(wanted))
    assert terms["rank"] > 0.1
    failed = given["pdm"][..., :2].prod(-1) == 0
    assert failed.any()
    given["pdm"][..., 2:] = torch.where(failed[..., None], 0.5, given["pdm"][..., 2:])
    changed = objective(given, *drawn)[1]
    torch.testing.assert_close(changed["simulation"], terms["simulation"])
    plain = WoteObjective(objective.model, WoteObjectiveConfig())
    assert "rank" not in plain(given, *drawn)[1]


def test_distances_and_labels() -> None:
    anchors = torch.zeros(2, 3, 3)
    anchors[1, :, 0] = 3.0
    future = torch.zeros(1, 3, 3)
    future[..., 1] = 4.0
    torch.testing.assert_close(distances(anchors[None], future), torch.tensor([[4.0, 5.0]]))
    apart, labels = torch.tensor([[0.0, 2 * math.log(3.0)]]), torch.tensor([[0.75, 0.25]])
    loss = likeness_loss(labels.log(), apart, over=2.0)
    torch.testing.assert_close(loss, -(labels * labels.log()).sum(-1))


def test_the_focal_loss_of_half_a_chance() -> None:
    logits, classes = torch.zeros(1, 2, 1, 2), torch.tensor([[[0, 1]]])
    wanted = 0.5 * 0.25 * torch.tensor(2.0).log()
    torch.testing.assert_close(focal_loss(logits, classes), wanted[None])
    sure = torch.tensor([[[[9.0]], [[-9.0]]]])
    assert focal_loss(sure, torch.tensor([[[0]]])) < 1e-6


def test_boxes_are_matched_at_the_least_cost() -> None:
    boxes = torch.tensor([[0.0, 0, 0, 4, 2], [10.0, 0, 3.1, 4, 2]])
    # The first query lies between both; alone it would take the second box.
    states = torch.tensor([[6.0, 0, 0, 4, 2], [10.0, 0, -3.1, 4, 2], [50.0, 0, 0, 4, 2]])
    both = torch.stack([states, states.flip(0)])
    found = match(both, torch.zeros(2, 3), boxes.expand(2, 2, 5), torch.tensor([2, 1]))
    # The other scene has one box, matched to the nearest query.
    assert set(zip(*(each.tolist() for each in found), strict=True)) == {
        (0, 0, 0),
        (0, 1, 1),
        (1, 2, 0),
    }


def test_the_loss_of_boxes_that_are_all_found() -> None:
    boxes = torch.tensor([[[1.0, 2, 0.5, 4, 2], [0.0, 0, 0, 0, 0]]])
    states = boxes.flip(1)
    sure = torch.tensor([[-20.0, 20.0]])
    assert agent_loss(states, sure, boxes, torch.tensor([1])) < 1e-6
    nobody = agent_loss(states, sure, boxes, torch.tensor([0]))
    assert nobody == pytest.approx(10.0, rel=1e-3)  # one of two queries is wrong by 20


def test_a_turn_is_measured_the_short_way() -> None:
    states, boxes = torch.zeros(1, 1, 5), torch.zeros(1, 1, 5)
    states[..., 2], boxes[..., 2] = torch.pi - 0.1, -torch.pi + 0.1
    loss = agent_loss(states, torch.tensor([[20.0]]), boxes, torch.tensor([1]))
    assert loss == pytest.approx(0.2 / 5, rel=1e-4)


def test_likely_anchors_are_drawn_as_often_as_their_scores_say() -> None:
    logits = torch.tensor([0.6, 0.3, 0.1]).log().expand(20_000, -1)
    luck = torch.rand(logits.shape, generator=torch.Generator().manual_seed(0))
    first = likely(logits, luck)[:, 0].bincount() / len(logits)
    torch.testing.assert_close(first, torch.tensor([0.6, 0.3, 0.1]), atol=0.02, rtol=0.0)


def test_occupancy_is_learnt_where_its_weight_says_so() -> None:
    logits = torch.zeros(1, 2, 4, 4)
    assert occupancy_loss(logits, torch.ones(1, 2, 4, 4).byte()) == pytest.approx(math.log(2))
    model, given = tiny_wote().train(), batch()
    for weight, learns in ((0.0, False), (1.0, True)):
        objective = WoteObjective(model, WoteObjectiveConfig(occupancy=weight))
        model.zero_grad()
        objective(given, *objective.draw(2, 1, torch.Generator().manual_seed(0)))[0].backward()
        gradient = model.occupancy.out.weight.grad
        assert gradient is not None
        assert bool(gradient.any()) is learns


def test_rewards_may_learn_of_anchors_as_they_are_moved() -> None:
    model, given, asked = tiny_wote().train(), batch(), []
    given |= {"window": torch.tensor([4, 9]), "signs": torch.tensor([[1.0, -1.0, -1.0]] * 2)}
    del given["pdm"]

    def judge(windows: Tensor, trajectories: Tensor, speeds: Tensor | None) -> Tensor:
        assert (windows.tolist(), speeds) == ([4, 9], None)
        asked.append(trajectories)
        return torch.ones(*trajectories.shape[:2], 5)

    config = WoteObjectiveConfig(moved=True, rank=1.0)
    objective = WoteObjective(model, config, judge)
    drawn = objective.draw(2, 1, torch.Generator().manual_seed(0))
    loss, terms = objective(given, *drawn)
    loss.backward()
    assert terms["simulation"].isfinite()
    with torch.no_grad():
        answer = model.score(*_context(model, given))["trajectories"]
    # Judged poses follow the order of the taken anchors, mirrored; a stop stays a stop.
    reflected = asked[0] * given["signs"][:, None, None]
    apart = torch.cdist(reflected.flatten(2), answer.flatten(2))
    assert apart.amin(-1).max() < 1e-5
    assert len(set(apart[0].argmin(-1).tolist())) > 1
    with pytest.raises(ValueError, match="judge: expected one for moved anchors, got None"):
        WoteObjective(model, config)


def test_without_an_example_nothing_is_imitated() -> None:
    objective, given = WoteObjective(tiny_wote(), WoteObjectiveConfig()), batch()
    drawn = objective.draw(2, 1, torch.Generator().manual_seed(0))
    first = {name: value[:1] for name, value in given.items()}
    alone = objective(first, *(each[:1] for each in drawn))[1]
    given["is_example"] = given["is_recorded"] = torch.tensor([1.0, 0.0])
    terms = objective(given, *drawn)[1]
    for name in ("offset", "offset_imitation", "imitation", "future_semantics"):
        torch.testing.assert_close(terms[name], alone[name])
    given["is_example"] = given["is_recorded"] = torch.zeros(2)
    terms = objective(given, *drawn)[1]
    assert terms["offset"] == terms["imitation"] == terms["future_semantics"] == 0


def _context(model: WoTE, given: dict[str, Tensor]) -> list[Tensor]:
    context = model.encode(given["camera"], given["lidar"], given["ego_status"])
    return [context[name] for name in model.context_for_score]
