"""The planner's parts: shapes, units, frames and independence of the samples."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor
from torch.nn import functional as F

from anchorflow_models import L2SafetyCFM
from anchorflow_models.layers.embedding import GaussianFourierTime, sinusoidal_positions
from anchorflow_models.layers.lookup import lookup

BATCH, COUNT = 2, 5

Scene = dict[str, Tensor]
FieldOf = Callable[[L2SafetyCFM, Scene, Tensor], Tensor]


@pytest.fixture(scope="module")
def model(make_model: Callable[..., L2SafetyCFM]) -> L2SafetyCFM:
    return make_model()


@pytest.fixture
def scene(make_scene: Callable[..., Scene]) -> Scene:
    return make_scene()


def test_noise_already_meets_both_ends(model: L2SafetyCFM, scene: Scene) -> None:
    context = model.encode(**scene)
    x_0 = model.draw(torch.randn(1, COUNT, model.prior.rank), context)
    torch.testing.assert_close(
        x_0[:, :, 0], scene["x_curr"][:, None].repeat(1, COUNT, 1), atol=1e-5, rtol=0
    )
    torch.testing.assert_close(
        x_0[:, :, -1, :4], scene["x_goal"][:, None].repeat(1, COUNT, 1), atol=1e-5, rtol=0
    )


def test_si_and_normalised_units_are_inverse(model: L2SafetyCFM, scene: Scene) -> None:
    context = model.encode(**scene)
    x = model.draw(torch.randn(1, COUNT, model.prior.rank), context)
    state = model.prior.normalise(x, context["prior_mean"], context["units"])
    back = context["prior_mean"][:, None] + model.prior.to_si(state, context["si_units"])
    torch.testing.assert_close(back, x, atol=1e-5, rtol=1e-5)
    assert 0.5 < state.std().item() < 2.0


def test_samples_and_scenes_do_not_touch_each_other(
    model: L2SafetyCFM, scene: Scene, field_of: FieldOf
) -> None:
    noise = torch.randn(1, COUNT, model.prior.rank)
    together = field_of(model, scene, noise)
    alone = field_of(model, {k: v[1:] for k, v in scene.items()}, noise[:, 2:3])
    torch.testing.assert_close(together[1:, 2:3], alone, atol=1e-4, rtol=1e-4)
    assert together.abs().max() > 0.01


def test_each_input_is_heard(model: L2SafetyCFM, scene: Scene, field_of: FieldOf) -> None:
    noise = torch.randn(1, COUNT, model.prior.rank)
    base = field_of(model, scene, noise)
    for name, value in scene.items():
        if name == "map_geometry":
            changed = value + torch.tensor([0.3, 0.0, 0.0])
        elif name == "w_style":
            changed = value.flip(-1)
        else:
            changed = value + 0.2 * torch.rand_like(value)
        assert not torch.allclose(
            field_of(model, scene | {name: changed}, noise), base, atol=1e-5
        ), name


def test_the_field_turns_with_the_scene(
    model: L2SafetyCFM, scene: Scene, field_of: FieldOf
) -> None:
    """A quarter turn of map, start and goal turns the field and changes nothing else."""
    quarter = torch.tensor([[0.0, 1.0], [-1.0, 0.0]])  # row vectors: x to y, y to -x

    def turned(vectors: Tensor) -> Tensor:
        return (vectors.unflatten(-1, (-1, 2)) @ quarter).flatten(-2)

    images = ("cost_map", "clearance_field", "cost_to_go")
    other = {k: torch.rot90(v, -1, (-2, -1)) if k in images else v for k, v in scene.items()}
    other |= {k: turned(scene[k]) for k in ("x_curr", "x_goal")}
    noise = torch.randn(1, COUNT, model.prior.rank)
    expected = turned(field_of(model, scene, noise))
    torch.testing.assert_close(field_of(model, other, noise), expected, atol=1e-4, rtol=1e-4)


def test_modulation_depends_on_time_and_scene(model: L2SafetyCFM, scene: Scene) -> None:
    context = model.encode(**scene)
    times = torch.tensor([0.1, 0.9])
    together = model.modulate(times, context)
    torch.testing.assert_close(model.modulate(times[1:], context), together[:, 1:])
    assert not torch.allclose(together[:, 0], together[:, 1])
    assert not torch.allclose(together[0], together[1])


def test_lookup_equals_grid_sample() -> None:
    features = torch.randn(2, 12, 9, 4)
    points = torch.rand(2, 30, 2) * 2.6 - 1.3
    expected = F.grid_sample(
        features.permute(0, 3, 1, 2), points[:, :, None], padding_mode="border", align_corners=False
    )
    torch.testing.assert_close(lookup(features, points), expected[..., 0].transpose(1, 2))


def test_a_goal_at_the_start_is_no_special_case(
    model: L2SafetyCFM, scene: Scene, field_of: FieldOf
) -> None:
    scene = scene | {"x_goal": torch.cat([scene["x_curr"][:, :2], torch.zeros(BATCH, 2)], -1)}
    assert field_of(model, scene, torch.randn(1, COUNT, model.prior.rank)).isfinite().all()


def test_embeddings() -> None:
    positions = sinusoidal_positions(8, 16)
    assert positions.shape == (8, 16)
    torch.testing.assert_close(positions[0, 1::2], torch.ones(8))
    time = GaussianFourierTime(32)
    assert time(torch.rand(4, 7)).shape == (4, 7, 32)
