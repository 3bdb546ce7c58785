"""WoTE: its shapes, its anchors, what is imagined of them and what they are worth."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
import torch
from tiny_wote import AHEAD, TINY, sensors, tiny_wote
from torch import Tensor

from anchorflow_models.wote import RewardWeights, WoTE, WoteConfig, final_scores
from anchorflow_models.wote.stages import arcs, cells
from anchorflow_models.wote.world_model import WorldModel, inject

ALL_STEPS = replace(TINY, future_steps=2, shared_future=True, rewards_of_all_steps=True)

pytestmark = pytest.mark.usefixtures("no_grad")


@pytest.fixture
def no_grad() -> Any:
    with torch.no_grad():
        yield


def answer(model: WoTE, inputs: dict[str, Tensor]) -> dict[str, Tensor]:
    context = model.encode(**inputs)
    return context | scored(model, context)


def scored(model: WoTE, context: dict[str, Tensor]) -> dict[str, Tensor]:
    return model.score(*(context[name] for name in model.context_for_score))


@pytest.mark.parametrize(
    "config", [replace(TINY, kept=5), replace(TINY, future_steps=3, kept=5), AHEAD, ALL_STEPS]
)
def test_scenes_do_not_touch_one_another(config: WoteConfig) -> None:
    model, inputs = tiny_wote(config), sensors(config, B=3)
    together = answer(model, inputs)
    for b in range(3):
        alone = answer(model, {name: t[b : b + 1] for name, t in inputs.items()})
        for name, array in alone.items():
            torch.testing.assert_close(together[name][b], array[0], rtol=1e-4, atol=1e-5)


def test_a_trajectory_is_its_anchor_and_its_offset() -> None:
    model = tiny_wote()
    given = answer(model, sensors())
    assert given["offsets"].abs().max() > 0.01
    torch.testing.assert_close(
        given["trajectories"] - given["offsets"], model.anchors.expand(2, -1, -1, -1)
    )


def test_the_kept_anchors_are_those_of_the_best_offset_scores() -> None:
    whole, few = tiny_wote(), tiny_wote(replace(TINY, kept=5))
    inputs = sensors()
    context = whole.encode(**inputs)
    bev, ego = context["bev_tokens"], context["ego"]
    best = whole.move(bev, ego).logits.argsort(-1, descending=True)[:, :5]
    all_of_them, kept = scored(whole, context), scored(few, context)
    for name in ("trajectories", "offsets", "sim_rewards"):
        for b in range(2):
            torch.testing.assert_close(kept[name][b], all_of_them[name][b, best[b]])
    assert not torch.equal(best[0], best[1])
    torch.testing.assert_close(kept["im_rewards"].sum(-1), torch.ones(2))
    # Leaving anchors out moves all scores by one number, and so no choice.
    moved = kept["scores"] - all_of_them["scores"].gather(1, best)
    torch.testing.assert_close(moved, moved[:, :1].expand(-1, 5))


def test_without_offsets_the_anchors_are_answered() -> None:
    model = tiny_wote(replace(TINY, offsets=False))
    given = answer(model, sensors())
    assert given["offsets"].abs().max() == 0
    torch.testing.assert_close(given["trajectories"][1], model.anchors)


def test_the_final_score_is_the_papers_formula() -> None:
    imitation, simulation = torch.tensor([[0.3, -1.0]]), torch.randn(1, 2, 5)
    im = imitation.softmax(-1)
    nc, dac, ep, ttc, c = simulation.sigmoid().unbind(-1)
    wanted = 0.1 * im.log() + 0.5 * nc.log() + 0.5 * dac.log() + (5 * ttc + 2 * c + 5 * ep).log()
    torch.testing.assert_close(final_scores(imitation, simulation, RewardWeights()), wanted)
    sure = torch.full((1, 2, 5), -1e4)
    assert final_scores(imitation, sure, RewardWeights()).isfinite().all()


def test_a_place_lies_in_its_cell() -> None:
    places = torch.tensor([[31.9, 31.9], [0.1, 0.1], [-0.1, -0.1], [31.9, -31.9], [99.0, -99.0]])
    cell = cells(places, size=8, reach=32.0)
    assert cell.sum(-1).tolist() == [1.0] * 5
    assert cell.argmax(-1).tolist() == [0, 3 * 8 + 3, 4 * 8 + 4, 7, 7]  # left ahead first


def test_the_ego_is_added_in_its_cell_and_nowhere_else() -> None:
    bev, ego = torch.zeros(2, 1, 4, 3), torch.arange(12.0).reshape(2, 2, 3) + 1
    cell = torch.eye(4)[[1, 3]]
    told = inject(bev, cell, ego)
    assert told.shape == (2, 2, 4, 3)
    for b, k, at in ((0, 0, 1), (0, 1, 3), (1, 0, 1), (1, 1, 3)):
        torch.testing.assert_close(told[b, k, at], ego[b, k])
        assert told[b, k].count_nonzero() == 3


def test_each_future_step_is_one_more_turn_of_the_same_layers() -> None:
    torch.manual_seed(0)
    make = {"hidden": 8, "layers": 1, "cells": 4}
    once, twice = WorldModel(6, 2, steps=1, **make), WorldModel(6, 2, steps=2, **make)
    twice.load_state_dict(once.state_dict())
    ego, bev = torch.randn(1, 3, 6), torch.randn(1, 4, 6)
    here, there = torch.eye(4)[0], torch.eye(4)[[1, 2]].expand(1, 3, -1, -1)
    ego_1, (bev_1,) = once(ego, bev, here=here, there=there[:, :, :1])
    wanted = [
        once(ego_1[:, k : k + 1], bev_1[:, k], here=torch.zeros(4), there=there[:, :1, 1:])
        for k in range(3)
    ]
    got_ego, got_bev = twice(ego, bev, here=here, there=there)
    assert torch.equal(got_bev[0], bev_1)
    torch.testing.assert_close(got_ego, torch.cat([each[0] for each in wanted], 1))
    torch.testing.assert_close(got_bev[1], torch.cat([each[1][-1] for each in wanted], 1))


@torch.no_grad()
def test_rewards_of_all_steps_hear_the_first_and_a_shared_future_has_one_reader() -> None:
    model = tiny_wote(ALL_STEPS)
    names = {name.partition(".")[0] for name in model.state_dict()}
    assert "future_semantics" not in names
    assert model.world_model.places.shape[1] == 1
    inputs = sensors(ALL_STEPS, B=1)
    before, seen = answer(model, inputs), model.look(**inputs)
    judged = model.judge(seen.bev, model.move(seen.bev, seen.ego), fine=seen.fine)
    imagined = model.future_semantic_logits(judged.future[:, 0])
    assert imagined.shape == seen.semantics.shape
    width = ALL_STEPS.width
    model.rewards.future.weight[:, :width] = 0.0  # of the first step's BEV
    after = answer(model, inputs)
    assert not torch.equal(before["sim_rewards"], after["sim_rewards"])
    next(model.semantics.parameters()).mul_(2.0)
    assert not torch.equal(model.future_semantic_logits(judged.future[:, 0]), imagined)
    with pytest.raises(ValueError, match="shared_future: expected false with ground_sight"):
        replace(AHEAD, shared_future=True)


def test_without_a_world_model_the_future_is_the_present() -> None:
    world = WorldModel(6, 2, hidden=8, layers=0, cells=4, steps=1)
    ego, bev = torch.randn(1, 3, 6), torch.randn(1, 4, 6)
    here, there = torch.eye(4)[0], torch.eye(4)[[1]].expand(1, 3, -1, -1)
    future_ego, (future,) = world(ego, bev, here=here, there=there)
    assert torch.equal(future_ego, ego)
    assert torch.equal(future[:, :, 2:], bev[:, None, 2:].expand(-1, 3, -1, -1))
    torch.testing.assert_close(future[0, 1, 1], bev[0, 1] + ego[0, 1])


def test_arcs_keep_their_speed_and_end_at_their_heading() -> None:
    poses = torch.cat([torch.zeros(64, 1, 3), arcs(64, steps=80, dt=0.05)], 1)
    steps = poses[:, 1:, :2] - poses[:, :-1, :2]
    speed = steps.norm(dim=-1) / 0.05
    torch.testing.assert_close(speed, speed[:, :1].expand_as(speed), rtol=1e-3, atol=1e-3)
    assert 0.1 < speed.min() < 1
    assert 14 < speed.max() <= 15
    course = torch.atan2(steps[..., 1], steps[..., 0])
    torch.testing.assert_close(course, poses[:, 1:, 2], atol=0.02, rtol=0)
    assert poses[:, -1, 2].abs().max() <= math.pi / 2


def test_anchors_of_another_shape_are_refused() -> None:
    with pytest.raises(ValueError, match=r"anchors: expected shape \[12, 8, 3\], got \[12, 8, 2\]"):
        tiny_wote().set_anchors(torch.zeros(12, 8, 2))


def test_the_published_numbers() -> None:
    config = WoteConfig()
    assert (config.anchors, config.judged, config.width, config.hidden) == (256, 256, 256, 1024)
    with pytest.raises(ValueError, match="nc: expected at least 0, got -1"):
        RewardWeights(nc=-1)
