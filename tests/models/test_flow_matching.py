"""The path between noise and data, and the loss on it."""

import pytest
import torch

from anchorflow_models.flow_matching import LossWeights, flow_matching_loss, interpolate


def test_interpolation_runs_from_noise_to_data() -> None:
    x_0, x_1 = torch.randn(2, 3, 8, 6), torch.randn(2, 3, 8, 6)
    for t, expected in ((0.0, x_0), (1.0, x_1), (0.25, 0.75 * x_0 + 0.25 * x_1)):
        x_t, target = interpolate(x_0, x_1, torch.full((2, 3), t))
        torch.testing.assert_close(x_t, expected)
        torch.testing.assert_close(target, x_1 - x_0)


def test_each_weight_scales_its_own_term() -> None:
    predicted, target = torch.randn(2, 3, 8, 6), torch.randn(2, 3, 8, 6)
    position, velocity, acceleration = (predicted - target).chunk(3, -1)
    weights = LossWeights(lambda_vel=2.0, lambda_acc=3.0, lambda_jerk=5.0)
    total, terms = flow_matching_loss(predicted, target, weights)
    expected = (
        position.square().mean()
        + 2.0 * velocity.square().mean()
        + 3.0 * acceleration.square().mean()
        + 5.0 * acceleration.diff(dim=-2).square().mean()
    )
    torch.testing.assert_close(total, expected)
    assert list(terms) == ["position", "velocity", "acceleration", "jerk"]


def test_a_perfect_field_costs_nothing() -> None:
    target = torch.randn(1, 2, 8, 6)
    assert flow_matching_loss(target, target, LossWeights())[0].item() == pytest.approx(0.0)
