"""The normalised states are the network's own view of what the engine integrates in SI."""

from __future__ import annotations

import torch

from anchorflow_client.contract import uniform_schedule
from anchorflow_training.distillation.objective import (
    NormalisedFlow,
    drawn,
    start_states,
    started,
)
from anchorflow_training.distillation.teacher import Teacher
from anchorflow_training.evaluation import sample
from anchorflow_trajectory.ode.methods import MIDPOINT

Inputs = dict[str, torch.Tensor]


@torch.no_grad()
def test_noise_begins_at_the_same_normalised_state_in_every_scene(
    teacher: Teacher, inputs: Inputs, prior_mean: torch.Tensor
) -> None:
    """But for durations, of which none is drawn where the scene has a horizon."""
    model, flow = teacher.model, NormalisedFlow.of(teacher.model, inputs, prior_mean)
    noise = torch.randn(1, 5, model.prior.rank)
    z_0 = started(model, noise, inputs["limits"])
    whole = torch.tensordot(noise, start_states(model), 1)[0]
    given = inputs["limits"][:, 3] > 0
    assert given.tolist() == [False, False, True]
    torch.testing.assert_close(z_0[..., :-1], whole[None, ..., :-1].expand(3, -1, -1, -1))
    torch.testing.assert_close(z_0[:2, ..., -1], whole[None, ..., -1].expand(2, -1, -1))
    assert not z_0[2, ..., -1].any()
    x_0 = model.draw(noise, prior_mean, flow.context)
    torch.testing.assert_close(flow.in_si(z_0), x_0, rtol=1e-5, atol=1e-4)


def test_both_ways_of_sampling_agree(
    teacher: Teacher, inputs: Inputs, prior_mean: torch.Tensor
) -> None:
    noise = torch.randn(1, 5, teacher.model.prior.rank)
    schedule = uniform_schedule(2)
    states = drawn(teacher.model, inputs, noise, prior_mean, schedule=schedule, method=MIDPOINT)
    expected = sample(teacher.model, inputs, noise, prior_mean, steps=2)
    x_0 = teacher.model.draw(noise, prior_mean, teacher.model.encode(**inputs))
    assert (expected - x_0).abs().max() > 0.1
    torch.testing.assert_close(states, expected, rtol=1e-5, atol=1e-3)


def test_wider_noise_begins_farther_out_and_leaves_the_narrow_teacher_alone(
    teacher: Teacher,
) -> None:
    narrow = start_states(teacher.model)
    torch.testing.assert_close(start_states(teacher.widened(1.5).model), 1.5 * narrow)
    torch.testing.assert_close(start_states(teacher.model), narrow)
