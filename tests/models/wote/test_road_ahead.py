"""WoTE with `ground_sight` and `encounters`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch
from small_configs import WOTE
from tiny_wote import TINY, sensors, tiny_wote
from torch import Tensor

from anchorflow_models.wote import WoTE, WoteConfig

BACKBONE = replace(
    TINY.backbone, image_height=32, image_width=128, lidar_size=128, lidar_before=True
)
AHEAD = replace(TINY, ground_sight=True, encounters=((0.0, 0.0), (5.0, 0.0)), backbone=BACKBONE)


def planner(config: WoteConfig = AHEAD) -> WoTE:
    """Random weights, also for layers that start at zero."""
    model = tiny_wote(config)
    with torch.no_grad():
        for parameter in model.parameters():
            if not parameter.any():
                parameter.normal_(0, 0.05)
    return model


def rewards(model: WoTE, context: dict[str, Tensor], poses: Tensor) -> Tensor:
    """[K, 6] logits of anchors with poses [K, T, 3]."""
    bev = context["bev_tokens"]
    judged = model.judge(
        bev,
        model.move(bev, context["ego"]),
        fine=context["bev_fine"],
        foretold=context["foretold"],
        motion=context.get("ego_motion"),
        poses=poses[None],
    )
    return torch.cat([judged.simulation, judged.imitation[..., None]], -1)[0]


def standing(*places: float) -> Tensor:
    """[K, T, 3]: half of the anchors at the first place, the others at the second."""
    poses = torch.zeros(AHEAD.anchors, AHEAD.num_steps, 3)
    for half, place in zip(poses.chunk(len(places)), places, strict=True):
        half[..., 0] = place
    return poses


@torch.inference_mode()
def test_the_shapes() -> None:
    model = planner()
    context = model.encode(**sensors(AHEAD))
    assert model.context_for_score == ("bev_tokens", "ego", "bev_fine", "foretold")
    assert context["bev_tokens"].shape == (2, BACKBONE.bev_size**2, AHEAD.width)
    assert context["bev_fine"].shape == (2, 32, 32, 4)
    assert context["foretold"].shape == (2, len(AHEAD.foretold_times), 20 + 32, 32)
    assert context["bev_semantics"].shape == (2, 3, 64, 128)
    scored = model.score(*(context[name] for name in model.context_for_score))
    assert scored["scores"].shape == (2, 12)


@torch.inference_mode()
def test_scenes_do_not_touch_one_another() -> None:
    model, inputs = planner(), sensors(AHEAD, B=2)
    together = model.encode(**inputs)
    alone = model.encode(**{name: tensor[1:] for name, tensor in inputs.items()})
    for name, array in alone.items():
        torch.testing.assert_close(together[name][1:], array, rtol=1e-4, atol=1e-5)


@torch.inference_mode()
def test_rewards_heed_what_lies_beyond_the_lidar_where_an_anchor_leads() -> None:
    model = planner()
    context = model.encode(**sensors(AHEAD, B=1))
    changed = dict(context, bev_fine=context["bev_fine"].clone())
    changed["bev_fine"][:, 6:10] += 1.0  # 2 m a row from 56 m ahead: 36 to 44 m
    before, after = (rewards(model, each, standing(40.0, 20.0)) for each in (context, changed))
    assert (before == after).all(-1).tolist() == [False] * 6 + [True] * 6


@torch.inference_mode()
def test_rewards_are_told_who_will_be_where_an_anchor_leads() -> None:
    model = planner()
    context = model.encode(**sensors(AHEAD, B=1))
    free = dict(context, foretold=torch.zeros_like(context["foretold"]))
    taken = dict(context, foretold=torch.zeros_like(context["foretold"]))
    taken["foretold"][:, :, 20 + 9 : 20 + 13, 14:18] = 1.0  # 6 to 14 m ahead
    poses = standing(10.0, 10.0)
    poses[6:, :, 1] = 20.0  # to the left
    before, after = (rewards(model, each, poses) for each in (free, taken))
    assert (before == after).all(-1).tolist() == [False] * 6 + [True] * 6


@torch.inference_mode()
def test_rewards_look_where_a_car_drives_that_follows_an_anchor() -> None:
    model = planner(replace(AHEAD, driven=True))
    context = model.encode(**sensors(AHEAD, B=1))
    assert model.context_for_score[-1] == "ego_motion"
    changed = dict(context, bev_fine=context["bev_fine"].clone())
    changed["bev_fine"][:, 22:25] += 1.0  # 2 m a row from 56 m ahead: 6 to 12 m
    told_to_stand = standing(0.0)
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
    size = BACKBONE.bev_size
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
    model = tiny_wote()
    assert not any(
        part in name for part in ("ground", "sweeps", "far", "met.") for name in model.state_dict()
    )
    assert not WoteConfig().ground_sight
    assert not WoteConfig().encounters
    assert not WoteConfig().driven


@torch.inference_mode()
def test_nothing_foretold_is_an_error() -> None:
    model = planner()
    context = model.encode(**sensors(AHEAD, B=1))
    with pytest.raises(ValueError, match="foretold: expected"):
        model.score(context["bev_tokens"], context["ego"], context["bev_fine"])


@torch.inference_mode()
def test_no_motion_to_tell_what_is_driven_is_an_error() -> None:
    model = planner(replace(AHEAD, driven=True))
    context = model.encode(**sensors(AHEAD, B=1))
    with pytest.raises(ValueError, match="motion: expected"):
        model.score(*(context[name] for name in model.context_for_score[:-1]))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"dt": 0.4}, r"dt: expected a multiple of 0.25 for encounters, got 0.4"),
        ({"footprint": ()}, "ground_sight: expected false without a footprint, got True"),
        ({"backbone": replace(BACKBONE, lidar_before=False)}, "encounters: expected none without"),
        (
            {"footprint": (), "encounters": (), "driven": True},
            "driven: expected false without footprint or encounters, got True",
        ),
        (
            {"backbone": replace(BACKBONE, lidar_size=96)},
            "backbone: expected a BEV of 8 n cells a side for ground_sight, got 12",
        ),
    ],
)
def test_a_wrong_field_is_named(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(AHEAD, **wrong)


def test_the_small_one_has_all() -> None:
    assert WOTE.ground_sight
    assert WOTE.encounters[:5] == WOTE.footprint
    assert WOTE.foretold_times[-1] == 5.0
    assert WOTE.driven
