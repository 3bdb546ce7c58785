"""DiffusionDriveV2: the published shapes, and what depends on what."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
import torch
from small_configs import DIFFUSIONDRIVE as SMALL
from tiny_diffusiondrive import tiny_diffusiondrive
from torch import Tensor

from anchorflow_models.diffusiondrive import (
    DiffusionDriveConfig,
    DiffusionDriveV2,
    create_diffusiondrive,
)
from anchorflow_models.diffusiondrive.config import FORETOLD_TIMES
from anchorflow_models.diffusiondrive.scorers import Scored, SeenUnder, encounters
from anchorflow_models.sub_scores import pdm_score

OF_SCENE = ("agent_queries", "ego_query")


def planner(config: DiffusionDriveConfig = SMALL) -> DiffusionDriveV2:
    return tiny_diffusiondrive(config)


def sensors(config: DiffusionDriveConfig = SMALL, B: int = 1) -> dict[str, Tensor]:
    torch.manual_seed(1)
    sizes = dict(config.backbone.input_sizes())
    return {
        "camera": torch.randint(0, 256, (B, *sizes["camera"])).byte(),
        "lidar": torch.rand(B, *sizes["lidar"]),
        "ego_status": torch.randn(B, 8),
    }


def whole(
    model: DiffusionDriveV2, inputs: dict[str, Tensor], **changed: Tensor
) -> dict[str, Tensor]:
    """Every stage once, with all candidates."""
    config = model.config
    told = model.encode(**inputs) | changed
    torch.manual_seed(2)
    begin = told["anchors"].repeat(1, config.groups, 1, 1)
    noise = torch.randn(begin.shape[1:])
    diversity = torch.randn(begin.shape[1], config.variants, 2)
    scene = [told[name] for name in OF_SCENE]
    told |= model.denoise(begin + 0.03 * noise, torch.tensor([8.0]), told["values"], *scene)
    diversity = diversity.expand(len(begin), -1, -1, -1)
    of_scorers = {name: told[name] for name in ("ego_motion", "foretold") if name in told}
    classes = told["class_scores"]
    told |= model.coarse(
        told["trajectories"], diversity, told["bev"], *scene, **of_scorers, class_scores=classes
    )
    best = told["coarse_scores"].argsort(-1, descending=True)[:, : config.keep]
    told["kept"] = torch.take_along_dim(told["candidates"], best[..., None, None], 1)
    features = torch.take_along_dim(told["features"], best[..., None], 1)
    coarse = {}
    if config.pessimistic:
        coarse = {
            "coarse_logits": torch.take_along_dim(told["coarse_logits"], best[..., None], 1),
            "coarse_imitation": torch.take_along_dim(told["coarse_imitation"], best, 1),
        }
    told |= coarse
    return told | model.fine(told["kept"], features, told["bev"], *scene, **of_scorers, **coarse)


def shapes(told: dict[str, Tensor]) -> dict[str, tuple[int, ...]]:
    return {name: tuple(tensor.shape) for name, tensor in told.items()}


@torch.inference_mode()
def test_the_published_shapes() -> None:
    config = DiffusionDriveConfig()
    with torch.device("meta"):  # shapes alone: nothing is computed
        model = create_diffusiondrive(config).to("meta").eval()
        told = shapes(whole(model, sensors(config)))
    assert {name: told[name] for name in ("bev", "values", "agent_queries", "ego_query")} == {
        "bev": (1, 256, 64, 64),
        "values": (1, 2, 64, 64, 256),
        "agent_queries": (1, 30, 256),
        "ego_query": (1, 1, 256),
    }
    assert (told["agents"], told["agent_scores"]) == ((1, 30, 5), (1, 30))
    assert (told["anchors"], told["bev_semantics"]) == ((1, 20, 8, 2), (1, 7, 128, 256))
    assert (told["x_0"], told["trajectories"]) == ((1, 200, 8, 2), (1, 200, 8, 3))
    assert (told["class_scores"], told["coarse_scores"]) == ((1, 200), (1, 800))
    assert (told["candidates"], told["features"]) == ((1, 800, 8, 3), (1, 800, 512))
    assert told["kept"] == (1, 32, 8, 3)
    assert (told["scores"], told["sub_scores"]) == ((1, 32), (1, 32, 5))
    assert "direction_scores" not in told


@torch.inference_mode()
def test_a_candidate_has_the_class_score_of_the_trajectory_that_it_varies() -> None:
    config = replace(SMALL, anchors=7, groups=2, variants=3, keep=5, vocabulary=4)
    told = whole(planner(config), sensors())
    own, fixed = told["poses_cls"][0].split([7 * 2 * 3, 4])
    torch.testing.assert_close(own.unflatten(0, (-1, 3)).T, told["class_scores"].expand(3, -1))
    assert (fixed == told["class_scores"].min()).all()


@torch.inference_mode()
def test_trajectories_are_denoised_each_for_itself() -> None:
    model = planner()
    told = model.encode(**sensors())
    scene = (told["values"], told["agent_queries"], told["ego_query"])
    x_t, t = told["anchors"].clone(), torch.tensor([8.0])
    before = model.denoise(x_t, t, *scene)["trajectories"]
    x_t[:, 0] += 0.2
    after = model.denoise(x_t, t, *scene)["trajectories"]
    torch.testing.assert_close(after[:, 1:], before[:, 1:])
    assert (after[:, 0] - before[:, 0]).abs().max() > 0.1


@torch.inference_mode()
def test_a_pessimist_expects_the_least_that_any_scorer_foretells() -> None:
    model = planner(replace(SMALL, pessimistic=True, anchors=7, groups=2, variants=3, keep=20))
    heard: list[list[Scored]] = []
    model.fine_scorer.register_forward_hook(lambda *told: heard.append(told[-1]))
    told = whole(model, sensors())
    logits = [told["coarse_logits"], *(scored.logits for scored in heard[0])]
    least = torch.stack(logits).amin(0)
    torch.testing.assert_close(told["sub_scores"], least[..., :5].sigmoid())
    torch.testing.assert_close(told["direction_scores"], least[..., 5].sigmoid())
    # Each of them decides somewhere, so none is left out.
    assert all((logit == least).any() for logit in logits)
    likely = torch.stack(
        [
            told["coarse_imitation"],
            *(each.imitation for each in heard[0] if each.imitation is not None),
        ]
    ).mean(0)
    beside = likely - likely.amax(-1, keepdim=True)
    wanted = pdm_score(least.sigmoid()) * (SMALL.imitation * beside).exp()
    torch.testing.assert_close(told["scores"], wanted)


OF_NO_DENOISER = ("bev", "ego_motion", "foretold")


@torch.inference_mode()
def test_every_stage_hears_the_scene() -> None:
    model, inputs = planner(), sensors()
    before = whole(model, inputs)
    for told in ("agent_queries", "ego_query", "ego_motion", "values", "bev", "foretold"):
        changed = before[told] + torch.linspace(0, 1, before[told].shape[-1])
        after = whole(model, inputs, **{told: changed})
        for name in ("trajectories", "coarse_scores", "scores"):
            heard = not torch.allclose(after[name], before[name], atol=1e-6)
            assert heard is not (told in OF_NO_DENOISER and name == "trajectories"), (told, name)


@torch.inference_mode()
def test_the_time_is_heard() -> None:
    model = planner()
    told = model.encode(**sensors())
    scene = (told["values"], told["agent_queries"], told["ego_query"])
    near, far = (model.denoise(told["anchors"], torch.tensor([t]), *scene) for t in (0.0, 40.0))
    assert (near["trajectories"] - far["trajectories"]).abs().max() > 1e-3


@torch.inference_mode()
def test_an_untrained_denoiser_leaves_points_where_they_are() -> None:
    torch.manual_seed(0)
    model = create_diffusiondrive(SMALL).eval()
    told = model.encode(**sensors())
    scene = (told["values"], told["agent_queries"], told["ego_query"])
    x_t = torch.linspace(-0.9, 0.9, 20 * 8 * 2).reshape(1, 20, 8, 2)
    torch.testing.assert_close(model.denoise(x_t, torch.tensor([8.0]), *scene)["x_0"], x_t)


@pytest.mark.parametrize(
    ("plain", "parts"),
    [
        ({"ego_motion": False, "driven": False, "encounters": (), "look_heads": 1}, ["motion"]),
        ({"ground_sight": False}, ["ground"]),
        ({"encounters": ()}, ["met", "sweeps", "foretold"]),
        ({"footprint": ()}, ["under"]),
    ],
    ids=["motion", "ground", "encounters", "footprint"],
)
@torch.inference_mode()
def test_the_published_planner_has_no_part_that_was_added(
    plain: dict[str, Any], parts: list[str]
) -> None:
    published = DiffusionDriveConfig()
    assert {name: getattr(published, name) for name in plain} == plain
    model = planner(replace(SMALL, **plain))
    assert not [
        n for n in {**model.state_dict(), **model.encode(**sensors())} for p in parts if p in n
    ]
    assert whole(model, sensors())["scores"].shape == (1, 32)


@pytest.mark.parametrize(
    ("rows", "ahead"),
    [(slice(44), (25.0, 5.0)), (slice(13, 19), (40.0, 20.0))],
    ids=["12 m ahead and more", "beyond the LiDAR's square"],
)
@torch.inference_mode()
def test_a_candidate_is_told_what_lies_under_its_own_car(
    rows: slice, ahead: tuple[float, float]
) -> None:
    torch.manual_seed(0)
    under = SeenUnder(SMALL)
    candidates = torch.zeros(1, 2, 8, 3)
    candidates[0, :, :, 0] = torch.tensor(ahead)[:, None]
    bev = torch.rand(1, SMALL.width, 64, 64)
    changed = bev.clone()
    changed[:, :, rows] += 1.0
    x = torch.zeros(1, 2, SMALL.scorer_width)
    apart = (under(x, candidates, changed) - under(x, candidates, bev))[0].abs().amax(-1)
    assert apart[0] > 1e-3
    assert apart[1] == 0.0


@pytest.mark.parametrize("scorer", ["coarse_scorer", "fine_scorer"])
@torch.inference_mode()
def test_both_scorers_look_under_the_car(scorer: str) -> None:
    model = planner()
    before = whole(model, sensors())
    getattr(model, scorer).under.footprint.whole.bias += 1.0
    after = whole(model, sensors())
    assert not torch.allclose(after["scores"], before["scores"], atol=1e-6)
    heard = not torch.allclose(after["coarse_scores"], before["coarse_scores"], atol=1e-6)
    assert heard is (scorer == "coarse_scorer")


@torch.inference_mode()
def test_the_fine_scorer_looks_where_a_car_drives_that_follows_a_candidate() -> None:
    model, inputs = planner(), sensors()
    inputs["ego_status"][:, 4] = 10.0
    before = whole(model, inputs)
    model.fine_scorer.driven = False
    after = whole(model, inputs)
    assert not torch.allclose(after["scores"], before["scores"], atol=1e-6)
    torch.testing.assert_close(after["coarse_scores"], before["coarse_scores"])


@torch.inference_mode()
def test_what_the_lidar_strikes_lies_at_its_place_of_the_road_ahead() -> None:
    perception, backbone = planner().perception, SMALL.backbone
    inputs = sensors()
    cells = torch.zeros(1, backbone.bev_size**2, SMALL.width)
    upscaled = torch.zeros(1, backbone.bev_channels, 64, 64)
    struck = upscaled.clone()
    struck[:, :, 2, 10] = 5.0  # 29.5 m ahead and 21.5 m to the left
    before, after = (
        perception._joined(cells, each, inputs["camera"], inputs["ego_status"])
        for each in (upscaled, struck)
    )
    assert (after - before)[0].norm(dim=0).argmax() == (2 + 24) * 64 + 10


def met_by(candidates: Tensor, *, at_s: float, ahead: int = 6) -> Tensor:
    """[M]: the change of candidates [M, T, 3] by an obstacle `ahead` m away at one time."""
    torch.manual_seed(0)
    met = encounters(SMALL)
    assert met is not None
    met.whole.weight.normal_()
    far = SMALL.backbone.far_size[0]
    free = torch.zeros(1, len(FORETOLD_TIMES), far + 64, 64)
    taken = free.clone()
    taken[0, FORETOLD_TIMES.index(at_s), far + 31 - ahead, 31:33] = 1.0
    x = torch.zeros(1, len(candidates), SMALL.scorer_width)
    heard = [met(x, candidates[None], maps) for maps in (taken, free)]
    return (heard[0] - heard[1])[0].abs().amax(-1)


@torch.inference_mode()
def test_a_candidate_is_told_whom_it_meets_when_it_is_there() -> None:
    candidates = torch.zeros(2, 8, 3)
    candidates[:, :, 0] = 2.0 * torch.arange(1, 9)  # m, a pose each
    candidates[1, :, 1] = 12.0  # to the left
    as_the_third_is_reached = met_by(candidates, at_s=1.5)
    assert as_the_third_is_reached[0] > 1e-3
    assert as_the_third_is_reached[1] == 0.0
    assert met_by(candidates, at_s=4.0)[0] == 0.0  # 16 m ahead by then


@torch.inference_mode()
def test_a_candidate_is_told_whom_it_would_meet_within_a_second() -> None:
    candidates = torch.full((2, 8, 3), -20.0) * torch.tensor([1.0, 0.0, 0.0])
    candidates[:, 2, 0] = 0.0
    candidates[0, 1, 0], candidates[1, 1, 0] = -4.0, 0.0  # 8 m/s, and standing
    three_quarters_later = met_by(candidates, at_s=2.25)
    assert three_quarters_later[0] > 1e-3
    assert three_quarters_later[1] == 0.0
    assert met_by(candidates, at_s=1.5)[0] == 0.0  # not yet
    assert met_by(candidates, at_s=3.0)[0] == 0.0  # no candidate leads there


@torch.inference_mode()
def test_it_looks_beyond_the_lidar_s_square() -> None:
    candidates = torch.zeros(1, 8, 3)
    candidates[:, :, 0] = 12.0 * torch.arange(1, 9)  # m, a pose each
    assert met_by(candidates, at_s=2.0, ahead=48)[0] > 1e-3
    assert met_by(candidates, at_s=2.0, ahead=44)[0] == 0.0


@torch.inference_mode()
def test_it_looks_on_along_the_heading() -> None:
    candidates = torch.full((2, 8, 3), -20.0) * torch.tensor([1.0, 0.0, 0.0])
    candidates[:, 1, 0], candidates[:, 2, 0] = -4.0, 0.0  # 8 m/s
    candidates[1, 2, 2] = torch.pi / 2
    assert (met_by(candidates, at_s=2.25) > 1e-3).tolist() == [True, False]


@torch.inference_mode()
def test_the_ego_s_query_is_told_the_status_in_its_units() -> None:
    model, inputs = planner(), sensors()
    found = model.perception(**inputs).scene
    faster = inputs | {"ego_status": inputs["ego_status"].clone()}
    faster["ego_status"][:, 4] += 10.0
    moved = model.perception(**faster).scene
    assert moved.motion is not None
    assert found.motion is not None
    torch.testing.assert_close(moved.motion - found.motion, torch.tensor([[10.0, 0, 0, 0]]))
    # A unit more: a column of the status's weights, and what the decoder makes of it.
    model.perception.decoder = torch.nn.Identity()  # type: ignore[assignment]
    model.perception.decoder.forward = lambda queries, _known: queries  # type: ignore[assignment]
    apart = model.perception(**faster).scene.ego - model.perception(**inputs).scene.ego
    torch.testing.assert_close(apart[0, 0], model.perception.status.weight[:, 4], atol=1e-5, rtol=0)


def test_of_equals_the_likelier_scores_higher() -> None:
    even = torch.full((1, 2, 5), 0.7).logit()
    scored = Scored(torch.zeros(1, 2, 4), even, torch.tensor([[3.0, 1.0]]), weight=0.1)
    worth = float(pdm_score(torch.full((5,), 0.7)))
    torch.testing.assert_close(
        scored.scores, torch.tensor([[worth, worth * math.exp(-0.1 * (3.0 - 1.0))]])
    )
