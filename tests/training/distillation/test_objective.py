"""On dz/dt = -a z every method's student is known in closed form: at it the loss is nothing."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch import Tensor, nn

from anchorflow_client.contract import uniform_schedule
from anchorflow_models.flow_matching import LossWeights
from anchorflow_training.distillation.objective import (
    ConsistencyObjective,
    DirectObjective,
    NormalisedFlow,
    ReflowObjective,
    drawn,
    start_states,
    started,
)
from anchorflow_training.distillation.teacher import Teacher
from anchorflow_training.evaluation import sample
from anchorflow_trajectory.ode.methods import MIDPOINT

RATE = 1.2
END = math.exp(-RATE)  # the teacher's end from 1
WEIGHTS = LossWeights()
B, N, T, S, R = 2, 5, 7, 7, 3

Gain = Callable[[Tensor], Tensor]


class LinearFlow(nn.Module):
    """dz/dt = gain(t) z in every scene; SI and normalised states are the same."""

    def __init__(self, gain: Gain) -> None:
        super().__init__()
        self.gain = gain
        states = torch.randn(R, T, S, generator=torch.Generator().manual_seed(3))
        self.prior = SimpleNamespace(
            factor=torch.eye(R),
            disturbed=lambda noise: torch.tensordot(noise, states, 1),
            spread=torch.ones(S),
            rank=R,
            to_si=lambda z, _: z,
            normalise=lambda x, *_: x,
        )

    def encode(self, limits: Tensor) -> dict[str, Tensor]:
        return dict.fromkeys(("units", "si_units"), torch.zeros(len(limits)))

    def modulate(self, t: Tensor, _: object) -> Tensor:
        return self.gain(t)[..., None, None]

    def normalised_field(
        self, _x: Tensor, z: Tensor, _mean: Tensor, modulation: Tensor, _: object
    ) -> Tensor:
        return modulation * z


def constant(value: float | Tensor) -> Gain:
    return lambda t: value + 0 * t


def pair_batch() -> dict[str, Tensor]:
    z_0 = torch.randn(B, N, T, S, generator=torch.Generator().manual_seed(0))
    told = {"limits": torch.zeros(B, 4), "prior_mean": torch.zeros(B, N, T, S)}
    return {**told, "z_0": z_0, "z_1": END * z_0, "reference_s": torch.ones(B)}


def data_batch() -> dict[str, Tensor]:
    states = torch.randn(B, N, T, S, generator=torch.Generator().manual_seed(1))
    batch = {"limits": torch.zeros(B, 4), "prior_mean": torch.zeros(B, N, T, S)}
    return {**batch, "states": states, "route": torch.zeros(B, N, dtype=torch.long)}


def loss_of(objective: nn.Module, batch: dict[str, Tensor], seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return objective(batch, *objective.draw(B, N, generator))[0]  # type: ignore[operator]


def direct(gain: Gain, schedule: tuple[float, ...], **options: Any) -> DirectObjective:
    model: nn.Module = LinearFlow(gain)
    return DirectObjective(model, schedule=schedule, weights=WEIGHTS, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("schedule", "gain"),
    [
        ((0.0, 1.0), END - 1),
        ((0.0, 0.5, 1.0), 2 * (math.sqrt(END) - 1)),
        ((0.0, 0.25, 0.5, 0.75, 1.0), 4 * (END**0.25 - 1)),
    ],
)
def test_direct_steps_end_where_the_teacher_ends(schedule: tuple[float, ...], gain: float) -> None:
    assert loss_of(direct(constant(gain), schedule), pair_batch()) < 1e-12
    assert loss_of(direct(constant(-RATE), schedule), pair_batch()) > 1e-4


def test_direct_gradients_run_through_every_step() -> None:
    """An Euler step of gain g on each half: d/dg of (1 + g/2)^2 is 1 + g/2, not half of it."""
    gain = torch.tensor(-0.5, requires_grad=True)
    batch = pair_batch()
    loss_of(direct(constant(gain), (0.0, 0.5, 1.0)), batch).backward()
    end = torch.tensor(-0.5, dtype=torch.float32)
    slope = 1 + end / 2
    scale = loss_of(direct(constant(END), (0.0, 1.0)), batch)  # of ((1 + END) - END)^2 = 1
    expected = 2 * ((1 + end / 2) ** 2 - END) * slope * scale
    assert gain.grad is not None
    torch.testing.assert_close(gain.grad, expected, rtol=1e-4, atol=1e-6)


class SquaredSize(nn.Module):
    """A cost [B, N] of states [B, N, T, S]."""

    def forward(self, states: Tensor, inputs: dict[str, Tensor], reference_s: Tensor) -> Tensor:
        assert set(inputs) == {"limits"}
        return states.square().mean((2, 3)) / reference_s[:, None]


def test_direct_weighs_what_its_ends_cost() -> None:
    """The loss adds log(1 + J) of the student's own ends."""
    batch = pair_batch() | {"reference_s": torch.tensor([1.0, 4.0])}
    gain = constant(-RATE)
    plain = direct(gain, (0.0, 1.0))(batch)
    loss, terms = direct(gain, (0.0, 1.0), cost=SquaredSize(), cost_weight=0.3)(batch)
    end = (1 - RATE) * batch["z_0"]
    costs = end.square().mean((2, 3)) / torch.tensor([[1.0], [4.0]])
    torch.testing.assert_close(terms["cost"], torch.log1p(costs).mean())
    torch.testing.assert_close(loss, plain[0] + 0.3 * terms["cost"])
    assert set(terms) == {*plain[1], "cost"}


def test_direct_learns_to_cost_less() -> None:
    """Only the cost has a gradient at the teacher's own end."""
    gain = torch.tensor(END - 1, requires_grad=True)
    objective = direct(constant(gain), (0.0, 1.0), cost=SquaredSize(), cost_weight=1.0)
    loss_of(objective, pair_batch()).backward()
    assert gain.grad is not None
    assert gain.grad > 0.1  # a smaller end costs less


def reflow(gain: Gain, *, at_schedule: float = 0.3) -> ReflowObjective:
    model: Any = LinearFlow(gain)
    schedule = (0.0, 0.5, 1.0)
    return ReflowObjective(model, schedule=schedule, at_schedule=at_schedule, weights=WEIGHTS)


def consistency(gain: Gain, *, intervals: int) -> ConsistencyObjective:
    student: Any = LinearFlow(gain)
    teacher: Any = LinearFlow(constant(-RATE))
    return ConsistencyObjective(
        student, teacher, intervals=intervals, optimal_transport=False, weights=WEIGHTS
    )


def straight(t: Tensor) -> Tensor:
    """The field of straight lines from z to END z, at their point at t."""
    return (END - 1) / (1 + t * (END - 1))


def test_reflow_learns_the_straight_field() -> None:
    assert loss_of(reflow(straight), pair_batch()) < 1e-12
    assert loss_of(reflow(constant(-RATE)), pair_batch()) > 1e-2


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_reflow_s_times_are_the_schedule_s_or_all(share: float) -> None:
    (t,) = reflow(straight, at_schedule=share).draw(50, 40, torch.Generator().manual_seed(0))
    at_schedule = (t == 0.0) | (t == 0.5)
    assert at_schedule.float().mean() == share
    if share:
        assert 0.4 < (t == 0.5).float().mean() < 0.6
    else:
        assert 0.45 < t.mean() < 0.55


def seen_from(rate: float) -> Gain:
    """The field whose straight path from any t ends at e^(-rate (1 - t)) z."""

    def gain(t: Tensor) -> Tensor:
        left = (1 - t).clamp(min=1e-6)
        return (torch.exp(-rate * left) - 1) / left

    return gain


def test_consistency_sees_one_end_along_the_teacher_s_path() -> None:
    """Up to the error of a midpoint step: third order, so 64 times less in intervals a quarter as
    long, and its square in the loss."""
    coarse, fine = (
        loss_of(consistency(seen_from(RATE), intervals=n), data_batch()).item() for n in (4, 16)
    )
    assert coarse < 1e-4
    assert fine < coarse / 1000
    assert loss_of(consistency(constant(-RATE), intervals=4), data_batch()) > 1e-3


def test_consistency_targets_pass_no_gradient() -> None:
    """With g constant the end seen from t is (1 + (1 - t) g) z; the target does not move with g."""
    gain = torch.tensor(-0.5, requires_grad=True)
    objective, batch = consistency(constant(gain), intervals=2), data_batch()
    loss_of(objective, batch).backward()
    assert gain.grad is not None
    frozen = gain.detach()
    _, t = objective.draw(B, N, torch.Generator().manual_seed(0))

    def loss_with(change: float) -> float:
        """The loss if g changes at the samples' own times alone, not at the targets'."""

        def law(at: Tensor) -> Tensor:
            return frozen + 0 * at + (change if torch.equal(at, t) else 0.0)

        return loss_of(consistency(law, intervals=2), batch).item()

    step = 1e-2
    slope = (loss_with(step) - loss_with(-step)) / (2 * step)
    assert gain.grad.item() == pytest.approx(slope, rel=1e-4)


def test_one_interval_of_consistency_is_a_regression_on_the_teacher() -> None:
    """From t = 0 a midpoint step over [0, 1] ends at (1 - a + a^2 / 2) z."""
    end = 1 - RATE + RATE**2 / 2
    assert loss_of(consistency(constant(end - 1), intervals=1), data_batch()) < 1e-12


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
    torch.testing.assert_close(flow.normalised(flow.in_si(z_0)), z_0, rtol=0, atol=1e-5)


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
