"""The path between noise and data, and the loss on it."""

from dataclasses import fields

import torch

from anchorflow_models.flow_matching import LossWeights, flow_matching_loss, interpolate


def test_interpolation_runs_from_noise_to_data() -> None:
    x_0, x_1 = torch.randn(2, 3, 8, 7), torch.randn(2, 3, 8, 7)
    for t, expected in ((0.0, x_0), (1.0, x_1), (0.25, 0.75 * x_0 + 0.25 * x_1)):
        x_t, target = interpolate(x_0, x_1, torch.full((2, 3), t))
        torch.testing.assert_close(x_t, expected)
        torch.testing.assert_close(target, x_1 - x_0)


def test_each_weight_scales_its_own_term() -> None:
    predicted, target = torch.randn(2, 3, 8, 7), torch.randn(2, 3, 8, 7)
    u, v, w, longer = (predicted - target).split([2, 2, 2, 1], -1)
    expected = {
        "velocity_field": u.square().mean(),
        "acceleration_field": v.square().mean(),
        "jerk_field": w.square().mean(),
        "roughness": w.diff(dim=-2).square().mean(),
        "duration_field": longer.square().mean(),
    }
    names = ("lambda_vel", "lambda_acc", "lambda_jerk", "lambda_roughness", "lambda_duration")
    for name, term in zip(names, expected, strict=True):
        alone = {part.name: 0.0 for part in fields(LossWeights)} | {name: 2.0}
        total, terms = flow_matching_loss(predicted, target, LossWeights(**alone))
        torch.testing.assert_close(total, 2.0 * expected[term])
        torch.testing.assert_close(terms, expected)


def test_a_sample_counts_as_much_as_its_weight() -> None:
    predicted, target = torch.randn(2, 3, 8, 7), torch.randn(2, 3, 8, 7)
    shares = torch.tensor([[0.0, 2.0, 1.0], [1.0, 0.5, 1.5]])
    weights = LossWeights()
    total, terms = flow_matching_loss(predicted, target, weights, sample_weights=shares)
    each = torch.stack(
        [
            flow_matching_loss(predicted[b, n], target[b, n], weights)[0]
            for b in range(2)
            for n in range(3)
        ]
    )
    torch.testing.assert_close(total, (each * shares.flatten()).mean())
    _, plain = flow_matching_loss(predicted, target, weights)
    _, ones = flow_matching_loss(predicted, target, weights, sample_weights=torch.ones(2, 3))
    torch.testing.assert_close(ones, plain)
    assert terms.keys() == plain.keys()
