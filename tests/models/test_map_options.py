"""What each way to see the map adds: lookup, attention, a wider window, any maps."""

from __future__ import annotations

import pytest
import torch
from flowmp_scenes import field_of, make_model, make_scene, means_of
from torch import Tensor

from anchorflow_models import L2SafetyCFM
from anchorflow_models.flowmp.cost_map_encoder import MapWindow
from anchorflow_models.flowmp.frame import Frame
from anchorflow_models.layers.attention import MapAttention

Scene = dict[str, Tensor]

COUNT = 3


@torch.no_grad()
def field_with_map_of(model: L2SafetyCFM, scene: Scene, other: Scene, mean: Tensor) -> Tensor:
    """The field where modulation and noise are one scene's, and the map is another's."""
    context, swapped = model.encode(**scene), model.encode(**other)
    noise = torch.randn(1, COUNT, model.prior.rank, generator=torch.Generator().manual_seed(0))
    modulation = model.modulate(torch.tensor([0.3]), context)[:, 0]
    return model.field(model.draw(noise, mean, context), mean, modulation, swapped)


@pytest.mark.parametrize(
    ("options", "sees"),
    [
        ({}, True),
        ({"map_lookup": False}, False),
        ({"map_lookup": False, "map_attention": True}, True),
        ({"map_lookup": False, "map_attention": True, "backbone": "unet"}, True),
        ({"feature_channels": 0}, True),
    ],
)
def test_the_field_itself_sees_the_map_only_by_lookup_or_attention(
    options: dict, sees: bool
) -> None:
    model, scene = make_model(map_size=16, **options), make_scene()
    mean = means_of(model, scene, COUNT)
    other = scene | {"clearance_field": -scene["clearance_field"]}
    same, swapped = (field_with_map_of(model, scene, one, mean) for one in (scene, other))
    assert torch.equal(same, swapped) != sees
    # The condition has the map's summary all the same.
    assert not torch.equal(*(model.encode(**one)["condition"] for one in (scene, other)))


def test_the_graphs_carry_what_the_options_ask_for() -> None:
    names = {
        (True, False, 1): ("features",),
        (True, False, 2): ("features", "wide_features"),
        (True, True, 1): ("features", "map_keys_values"),
        (False, True, 2): ("map_keys_values",),
        (False, False, 1): (),
    }
    for (lookup, attention, scales), expected in names.items():
        options = {"map_lookup": lookup, "map_attention": attention, "map_scales": scales}
        model = make_model(map_size=16, **options)
        assert model.context_for_modulate == ("condition",)
        assert model.context_for_field == (
            "frame",
            "motion_limits",
            "units",
            "si_units",
            *expected,
        )


@torch.no_grad()
def test_map_tokens_know_their_places() -> None:
    """The same cells in other places are another map; tokens in another order are not."""
    model = make_model(map_size=32, map_attention=True)
    coarse = torch.randn(1, 96, 4, 4)
    tokens, mirrored = model.map_tokens([coarse]), model.map_tokens([coarse.flip(-1)])
    again = mirrored.unflatten(1, (4, 4)).flip(2).flatten(1, 2)
    assert not torch.allclose(tokens, again, atol=1e-2)
    x, order = torch.randn(1, 3, 8, 128), torch.randperm(16)
    attention = next(m for m in model.transformer.modules() if isinstance(m, MapAttention))
    answers = [attention(x, attention.keys_values(t)) for t in (tokens, tokens[:, order], again)]
    torch.testing.assert_close(answers[0], answers[1])
    assert not torch.allclose(answers[0], answers[2], atol=1e-3)


def test_attention_can_tell_where_a_trajectory_lies() -> None:
    """Two trajectories of the same residuals in other places get other answers."""
    model = make_model(map_size=16, map_attention=True, map_lookup=False)
    with torch.no_grad():
        context = model.encode(**make_scene())
        modulation = model.modulate(torch.tensor([0.3]), context)[:, 0]
        mean = means_of(model, make_scene(), 1)
        state = torch.zeros_like(mean)
        place = torch.zeros(7)
        place[:2] = 1.0
        here, there = (
            model.normalised_field(mean + offset, state, mean, modulation, context)
            for offset in (0.0 * place, place)
        )
    assert not torch.allclose(here, there, atol=1e-4)


@pytest.mark.parametrize("options", [{}, {"map_lookup": False}, {"map_attention": True}])
def test_the_second_window_sees_twice_as_far(options: dict) -> None:
    scene = make_scene()
    # A short way in the middle of the map: the window ends 2.3 m from its centre, the map 4 m.
    scene["x_curr"][:, :2] = torch.tensor([-0.5, 0.0])
    scene["x_goal"][:, :2] = torch.tensor([0.5, 0.0])
    far = scene["cost_map"].clone()
    far[..., :4] = 1.0  # 3.2 m from the centre and further
    for scales, sees in ((1, False), (2, True)):
        model = make_model(map_size=16, map_scales=scales, **options)
        noise = torch.randn(1, COUNT, model.prior.rank)
        base, other = (
            field_of(model, scene | {"cost_map": m}, noise) for m in (scene["cost_map"], far)
        )
        assert torch.equal(base, other) != sees


def test_each_window_is_looked_up_where_the_trajectory_is() -> None:
    """Tables that hold the metric place of each cell return the places."""
    model, scene = make_model(map_scales=2, feature_channels=0), make_scene()
    frame = Frame.between(scene["x_curr"][:, :2], scene["x_goal"][:, :2])
    tables = {
        name: frame.widened(width).window(64).unflatten(1, (64, 64))
        for name, width in model.windows.items()
    }
    places = frame.centre[:, None] + torch.tensor([[0.5, -1.0], [-1.5, 0.7]])
    seen = model._seen(frame.place(places), tables)
    torch.testing.assert_close(seen, torch.cat([places, places], -1), atol=1e-5, rtol=0)


@pytest.mark.parametrize("shape", [(16, 40), (97, 50)])
def test_maps_of_any_size_are_resampled(shape: tuple[int, int]) -> None:
    """A ramp across 8 m of map, in any cells, is the same ramp across the window."""
    height, width = shape
    resolution = 8.0 / width
    ramp = ((torch.arange(width) + 0.5) / width).expand(1, 1, height, width)
    geometry = torch.tensor([[-4.0, -0.5 * height * resolution, resolution]])
    frame = Frame.between(torch.tensor([[-0.5, 0.0]]), torch.tensor([[0.5, 0.0]]))
    seen = MapWindow(1, 16)(ramp, geometry, torch.zeros(1, *shape), frame)
    x = frame.window(16)[..., 0].unflatten(1, (16, 16))
    rows = slice(7, 9)  # well inside the map, however few rows it has
    torch.testing.assert_close(seen[:, 2, rows], (x[:, rows] + 4) / 8, atol=1e-5, rtol=0)
