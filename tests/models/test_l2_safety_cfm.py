"""The planner's parts: shapes, units, frames and independence of the samples."""

import math

import pytest
import torch
from flowmp_scenes import field_of, make_model, make_scene, means_of
from torch import Tensor
from torch.nn import functional as F

from anchorflow_models import L2SafetyCFM
from anchorflow_models.layers.places import lookup

BATCH, COUNT = 2, 5

Scene = dict[str, Tensor]


@pytest.fixture(scope="module")
def model() -> L2SafetyCFM:
    return make_model()


@pytest.fixture
def scene() -> Scene:
    return make_scene()


def test_each_input_is_heard(model: L2SafetyCFM, scene: Scene) -> None:
    noise, mean = torch.randn(1, COUNT, model.prior.rank), means_of(model, scene, COUNT)
    base = field_of(model, scene, noise, mean)
    changed = {name: value + 0.2 * torch.rand_like(value) for name, value in scene.items()}
    changed["map_geometry"] = scene["map_geometry"] + torch.tensor([0.3, 0.0, 0.0])
    changed["w_style"] = scene["w_style"].flip(-1)
    for name, value in changed.items():
        assert not torch.allclose(
            field_of(model, scene | {name: value}, noise, mean), base, atol=1e-5
        ), name
    for column, name in enumerate(("v_max", "a_max", "robot_radius", "horizon_s")):
        limits = scene["limits"].clone()
        limits[:, column] += 0.3
        other = field_of(model, scene | {"limits": limits}, noise, mean)
        assert not torch.allclose(other, base, atol=1e-5), name


def test_the_route_of_a_sample_is_heard_by_it_alone(model: L2SafetyCFM, scene: Scene) -> None:
    """The same residual on another route is another question."""
    noise = torch.randn(1, COUNT, model.prior.rank)
    mean = means_of(model, scene, COUNT)
    other = mean.clone()
    other[:, 1] = mean[:, 3]
    changed = ~torch.isclose(
        field_of(model, scene, noise, mean), field_of(model, scene, noise, other), atol=1e-5
    ).all(-1).all(-1)
    assert changed.tolist() == [[False, True, False, False, False]] * BATCH


def turned(vectors: Tensor) -> Tensor:
    """[..., 2 k] after a quarter turn, x to y and y to -x."""
    quarter = torch.tensor([[0.0, 1.0], [-1.0, 0.0]])  # row vectors
    return (vectors.unflatten(-1, (-1, 2)) @ quarter).flatten(-2)


def states_turned(states: Tensor) -> Tensor:
    return torch.cat([turned(states[..., :6]), states[..., 6:]], -1)


def test_the_field_turns_with_the_scene(model: L2SafetyCFM, scene: Scene) -> None:
    """A quarter turn of map, ends and routes turns the field and changes nothing else."""
    images = ("cost_map", "clearance_field")
    other = {k: torch.rot90(v, -1, (-2, -1)) if k in images else v for k, v in scene.items()}
    other |= {k: turned(scene[k]) for k in ("x_curr", "x_goal")}
    noise, mean = torch.randn(1, COUNT, model.prior.rank), means_of(model, scene, COUNT)
    expected = states_turned(field_of(model, scene, noise, mean))
    field = field_of(model, other, noise, states_turned(mean))
    torch.testing.assert_close(field, expected, atol=1e-4, rtol=1e-4)


def test_the_field_moves_with_the_scene(model: L2SafetyCFM, scene: Scene) -> None:
    """Map, ends and routes elsewhere: the same field."""
    offset = torch.tensor([8.0, -4.0])
    place = torch.cat([offset, torch.zeros(4)])
    other = scene | {
        "map_geometry": scene["map_geometry"] + torch.cat([offset, torch.zeros(1)]),
        "x_curr": scene["x_curr"] + place,
        "x_goal": scene["x_goal"] + place[:4],
    }
    noise, mean = torch.randn(1, COUNT, model.prior.rank), means_of(model, scene, COUNT)
    expected = field_of(model, scene, noise, mean)
    moved = field_of(model, other, noise, mean + torch.cat([place, torch.zeros(1)]))
    torch.testing.assert_close(moved, expected, atol=2e-4, rtol=1e-3)


@pytest.mark.parametrize("backbone", ["transformer", "unet"])
@pytest.mark.parametrize("slower", [2.0, 4.0])
def test_a_slower_robot_in_its_own_time_is_given_the_same_field(
    scene: Scene, backbone: str, slower: float
) -> None:
    """v_max / k, a_max / k^2 and the ends' velocities / k, on routes that last k times as long."""
    model = make_model(backbone=backbone)
    by_field = torch.tensor([1.0, 1.0, slower, slower, slower**2, slower**2])
    other = scene | {
        "x_curr": scene["x_curr"] / by_field,
        "x_goal": scene["x_goal"] / by_field[:4],
        "limits": scene["limits"] / torch.tensor([slower, slower**2, 1.0, 1 / slower]),
    }
    noise, mean = torch.randn(1, COUNT, model.prior.rank), means_of(model, scene, COUNT)
    longer = mean + torch.tensor([0.0] * 6 + [math.log(slower)])
    expected = field_of(model, scene, noise, mean)
    torch.testing.assert_close(
        field_of(model, other, noise, longer), expected, atol=1e-4, rtol=1e-4
    )
    # One of them alone is another robot.
    assert not torch.allclose(field_of(model, other, noise, mean), expected, atol=1e-3)


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


def test_a_goal_at_the_start_is_no_special_case(model: L2SafetyCFM, scene: Scene) -> None:
    scene = scene | {"x_goal": torch.cat([scene["x_curr"][:, :2], torch.zeros(BATCH, 2)], -1)}
    assert field_of(model, scene, torch.randn(1, COUNT, model.prior.rank)).isfinite().all()
