"""What the network that predicts the others does not depend on."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from anchorflow_models.futures import FuturesConfig, FuturesNetwork

CONFIG = FuturesConfig(width=16, map_channels=4)


@pytest.fixture(scope="module")
def network() -> FuturesNetwork:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        return FuturesNetwork(CONFIG).eval()


def scene(*, seed: int = 0, count: int = 6) -> dict[str, Tensor]:
    generator = torch.Generator().manual_seed(seed)
    others = torch.randn(1, count, 5, 8, generator=generator)
    others[..., :2] *= 12.0
    others[..., 3:5] *= 5.0
    others[..., 5:] = torch.tensor([4.5, 2.0, 1.0])
    status = torch.tensor([[0.0, 1, 0, 0, 6.0, 0, 0, 0]])
    drawn = torch.randint(0, 256, (1, 20, 192, 128), generator=generator, dtype=torch.uint8)
    return {"others": others, "bev": drawn, "ego_status": status}


@torch.no_grad()
def test_the_likely_modes_come_first_and_nobody_has_none(network: FuturesNetwork) -> None:
    inputs = scene()
    inputs["others"][0, 4:] = 0.0
    told = network.futures(**inputs)
    poses, probabilities = told["futures"][0], told["future_probabilities"][0]
    assert poses.shape == (6, 6, 8, 3)
    assert (probabilities[:4].diff() <= 0).all()
    torch.testing.assert_close(probabilities.sum(-1), torch.tensor([1.0, 1, 1, 1, 0, 0]))
    assert not poses[4:].any()
    # Nobody changes nothing for the others.
    fewer = network.futures(**{**inputs, "others": inputs["others"][:, :4]})
    torch.testing.assert_close(poses[:4], fewer["futures"][0])


@torch.no_grad()
def test_the_order_of_the_others_does_not_matter(network: FuturesNetwork) -> None:
    inputs, order = scene(), torch.tensor([3, 0, 5, 1, 2, 4])
    poses, logits = network(**inputs)
    moved, others = network(**{**inputs, "others": inputs["others"][:, order]})
    torch.testing.assert_close(moved, poses[:, order])
    torch.testing.assert_close(others, logits[:, order])


@torch.no_grad()
def test_a_neighbour_matters_and_another_scene_does_not(network: FuturesNetwork) -> None:
    one, two = scene(), scene(seed=1)
    both = {name: torch.cat([one[name], two[name]]) for name in one}
    torch.testing.assert_close(network(**both)[0][:1], network(**one)[0])
    near = one["others"].clone()
    near[0, 1, :, :2] = near[0, 0, :, :2] + 3.0
    assert (
        network(**{**one, "others": near})[0][0, 0] - network(**one)[0][0, 0]
    ).abs().max() > 1e-4


@torch.no_grad()
def test_without_lanes_predictions_turn_with_the_scene(network: FuturesNetwork) -> None:
    """Everything but the ego is turned by a right angle, a kilometre away from it."""
    inputs = scene()
    inputs["others"][..., :2] += 1000.0
    inputs["bev"].zero_()
    inputs["ego_status"].zero_()
    poses, _ = network(**inputs)
    turned = inputs["others"].clone()
    for x, y in ((0, 1), (3, 4)):
        turned[..., x], turned[..., y] = -inputs["others"][..., y], inputs["others"][..., x]
    turned[..., 2] += torch.pi / 2
    rotated, _ = network(**{**inputs, "others": turned})
    expected = torch.stack([-poses[..., 1], poses[..., 0], poses[..., 2] + torch.pi / 2], -1)
    assert (rotated - expected).abs().max() < 1e-3
    away = (rotated - poses).abs().max()
    assert away > 5.0


@torch.no_grad()
def test_the_lanes_are_read_where_somebody_is(network: FuturesNetwork) -> None:
    """Row 0 lies at x = 80, column 0 at y = 32; a lane far from everybody changes nothing."""
    inputs = scene()
    inputs["others"][..., :2] *= 0.1
    inputs["bev"].zero_()
    poses, _ = network(**inputs)
    far = inputs["bev"].clone()
    far[:, :4, :30] = 255  # x from 65 m on
    torch.testing.assert_close(network(**{**inputs, "bev": far})[0], poses)
    near = inputs["bev"].clone()
    near[:, :4, 150:170] = 255  # x from -5 to 5 m
    assert (network(**{**inputs, "bev": near})[0] - poses).abs().max() > 1e-3


@pytest.mark.parametrize(("name", "value"), [("modes", 0), ("width", 4), ("dt", 0.0)])
def test_a_configuration_out_of_range_is_refused(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        FuturesConfig(**{name: value})  # pyright: ignore[reportArgumentType] - on purpose
