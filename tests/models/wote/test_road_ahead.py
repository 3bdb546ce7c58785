"""WoTE with `footprint`, `ground_sight` and `encounters`."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from flowmp_scenes import open_branches
from tiny_wote import AHEAD, TINY, sensors, tiny_wote
from torch import Tensor

from anchorflow_models.transfuser import placed
from anchorflow_models.wote import WoTE, WoteConfig

Place = tuple[float, float]


def planner(config: WoteConfig = AHEAD) -> WoTE:
    """Random weights, also for layers that start at zero."""
    model = tiny_wote(config)
    open_branches(model)
    return model


def rewards(model: WoTE, context: dict[str, Tensor], poses: Tensor) -> Tensor:
    """[K, 6] logits of anchors with poses [K, T, 3]."""
    bev = context["bev_tokens"]
    judged = model.judge(
        bev,
        model.move(bev, context["ego"]),
        fine=context["bev_fine"],
        foretold=context.get("foretold"),
        motion=context.get("ego_motion"),
        poses=poses[None],
    )
    return torch.cat([judged.simulation, judged.imitation[..., None]], -1)[0]


def standing(*places: Place) -> Tensor:
    """[K, T, 3]: half of the anchors at the first place (m), the others at the second."""
    poses = torch.zeros(AHEAD.anchors, AHEAD.num_steps, 3)
    for half, place in zip(poses.chunk(len(places)), places, strict=True):
        half[..., :2] = torch.tensor(place)
    return poses


@pytest.mark.parametrize(
    ("config", "name", "cells", "places"),
    [
        (AHEAD, "bev_fine", np.s_[:, 6:10], ((40.0, 0.0), (20.0, 0.0))),  # 36 to 44 m ahead
        (AHEAD, "foretold", np.s_[:, :, 29:33, 14:18], ((10.0, 0.0), (10.0, 20.0))),  # 6 to 14 m
        (TINY, "bev_fine", np.s_[:, :5], ((0.0, 0.0), (-20.0, 0.0))),  # about the ego and ahead
    ],
    ids=["beyond the lidar", "who will be there", "under the car"],
)
@torch.inference_mode()
def test_rewards_heed_what_lies_where_an_anchor_leads_and_nothing_beside(
    config: WoteConfig, name: str, cells: Any, places: tuple[Place, Place]
) -> None:
    model = planner(config)
    context = model.encode(**sensors(config, B=1))
    changed = context | {name: context[name].clone()}
    changed[name][cells] += 1.0
    before, after = (rewards(model, each, standing(*places)) for each in (context, changed))
    assert (before == after).all(-1).tolist() == [False] * 6 + [True] * 6


@torch.inference_mode()
def test_rewards_look_where_a_car_drives_that_follows_an_anchor() -> None:
    model = planner(replace(AHEAD, driven=True))
    context = model.encode(**sensors(AHEAD, B=1))
    assert model.context_for_score[-1] == "ego_motion"
    changed = dict(context, bev_fine=context["bev_fine"].clone())
    changed["bev_fine"][:, 22:25] += 1.0  # 2 m a row from 56 m ahead: 6 to 12 m
    told_to_stand = standing((0.0, 0.0))
    heard = []
    for speed in (0.0, 8.0):  # a moving car halts farther ahead
        motion = torch.tensor([[speed, 0.0, 0.0, 0.0]])
        before, after = (
            rewards(model, dict(each, ego_motion=motion), told_to_stand)
            for each in (context, changed)
        )
        heard.append(not torch.equal(before, after))
    assert heard == [False, True]


@torch.inference_mode()
def test_tokens_lie_where_the_ego_will_be() -> None:
    """Three of eight rows farther ahead: the ego is in the second row from behind."""
    size = AHEAD.backbone.bev_size
    here, there = planner()._cells()
    rows = here.nonzero().flatten() // size
    assert rows.tolist() == [7 * size // 8]
    assert AHEAD.bev_ahead == 24.0
    ends = planner().anchors[:, -1, 0]
    expected = ((56.0 - ends) / 64.0 * size).floor().clamp(0, size - 1)
    assert torch.equal((there[:, 0].argmax(-1) // size).float(), expected)


@torch.inference_mode()
def test_the_picture_moves_tokens_and_fine_cells() -> None:
    model, inputs = planner(), sensors(AHEAD, B=1)
    for name, weight in model.backbone.named_parameters():
        if "align_fused" in name:
            weight.zero_()  # the backbone's BEV does not depend on the picture
    before = model.encode(**inputs)
    after = model.encode(**{**inputs, "camera": 255 - inputs["camera"]})
    for name in ("bev_tokens", "bev_fine", "bev_semantics"):
        assert not torch.allclose(before[name], after[name], atol=1e-4), name


@torch.inference_mode()
def test_the_published_network_has_none_of_it() -> None:
    published, model = WoteConfig(), tiny_wote(replace(TINY, footprint=()))
    assert not any((published.ground_sight, published.encounters, published.driven))
    context = model.encode(**sensors())
    assert "bev_fine" not in context
    assert model.context_for_score == ("bev_tokens", "ego")
    assert model.score(context["bev_tokens"], context["ego"])["scores"].shape == (2, 12)
    added = ("footprint", "ground", "sweeps", "far", "met.")
    assert not [name for name in model.state_dict() if any(part in name for part in added)]


@pytest.mark.parametrize(
    ("config", "missing"),
    [(TINY, "fine"), (AHEAD, "foretold"), (replace(AHEAD, driven=True), "motion")],
)
@torch.inference_mode()
def test_a_missing_context_is_named(config: WoteConfig, missing: str) -> None:
    model = planner(config)
    context = model.encode(**sensors(config, B=1))
    with pytest.raises(ValueError, match=f"{missing}: expected"):
        model.score(*(context[name] for name in model.context_for_score[:-1]))


def places_of(x: float, y: float, heading: float) -> list[list[float]]:
    """Places of the car of one pose: its middle, and 3 m ahead and 1 m to its left."""
    return placed(torch.tensor([x, y, heading]), torch.tensor([(0.0, 0.0), (3.0, 1.0)])).tolist()


def test_places_turn_with_the_car() -> None:
    assert places_of(10.0, 2.0, 0.0) == [[10.0, 2.0], [13.0, 3.0]]
    (x, y) = places_of(10.0, 2.0, math.pi / 2)[1]
    assert math.isclose(x, 9.0, abs_tol=1e-5)
    assert math.isclose(y, 5.0, abs_tol=1e-5)
