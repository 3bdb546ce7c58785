"""The control barrier: its condition holds, it leaves alone what is clear, anchors gain room."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from anchorflow_models.generation import (
    ClearanceMap,
    GeneratorConfig,
    Guidance,
    TrajectoryGenerator,
)
from anchorflow_models.generation.steering import SLACK, Barrier
from anchorflow_trajectory.cost.clearance import clearance_field

RATE = 6.0
SCENES, COUNT, STEPS = 2, 5, 9


@pytest.fixture
def clearance() -> ClearanceMap:
    occupied = np.zeros((60, 60), bool)
    occupied[25:35, 25:35] = True
    values = torch.from_numpy(clearance_field(occupied, 0.1, 0.2)).expand(SCENES, -1, -1)
    return ClearanceMap(values, torch.tensor([[-3.0, -3.0, 0.1]] * SCENES))


@pytest.fixture
def barrier(clearance: ClearanceMap) -> Barrier:
    return Barrier(clearance, torch.tensor([0.1, 0.2]), RATE)


@pytest.fixture
def x() -> Tensor:
    """States [B, N, T, 7] whose places are all over the map, the first anchor's in the open."""
    generator = torch.Generator().manual_seed(0)
    states = 4 * torch.rand(SCENES, COUNT, STEPS, 7, generator=generator) - 2
    states[:, 0] = 1.8
    return states


def test_the_barrier_is_a_lower_bound_of_every_steps_room(barrier: Barrier, x: Tensor) -> None:
    room = barrier.clearance(x) - barrier.margin[:, None, None]
    h, _ = barrier.value_and_gradient(x)
    assert (h <= room.amin(-1)).all()
    assert float((room.amin(-1) - h).max()) < 0.06


@pytest.mark.parametrize("stride", [None, 0.01, 0.5])
def test_the_condition_holds_wherever_the_field_may_move(
    barrier: Barrier, x: Tensor, stride: float | None
) -> None:
    """dh/dt >= -α h, up to the slack, where x̂_1 moves by what was added to the field."""
    basis = torch.randn(SCENES, 54, STEPS * 7, generator=torch.Generator().manual_seed(1))
    field = torch.randn_like(x)
    kept = barrier.kept(field, x - 0.7 * field, 0.3, basis, stride=stride)
    h, gradient = barrier.value_and_gradient(x)
    rate = min(RATE, 1 / stride) if stride else RATE
    climb = (gradient * (kept - field)).sum((-2, -1))
    variance = (gradient.flatten(2) @ basis.transpose(1, 2)).square().sum(-1)
    assert (h < 0).sum() >= 4
    torch.testing.assert_close(climb, (-rate * h).clamp(min=0) * variance / (variance + SLACK**2))
    assert torch.equal(kept[h >= 0], field[h >= 0])
    assert (h >= 0).any()
    # Over one stride no anchor is carried past the barrier's zero, to first order.
    assert stride is None or (h + stride * climb <= h.clamp(min=0) + 1e-6).all()


def test_an_end_nearer_than_the_margin_lowers_it(clearance: ClearanceMap) -> None:
    ends = torch.tensor([[[2.0, 2.0], [-2.0, 2.0]], [[0.75, 0.0], [2.0, 2.0]]])
    margin = Barrier.of(clearance, margin=0.3, rate=RATE, ends=ends).margin
    assert margin.tolist() == pytest.approx([0.3, 0.05], abs=0.02)


def test_where_nothing_can_move_nothing_does(barrier: Barrier, x: Tensor) -> None:
    field = torch.randn_like(x)
    kept = barrier.kept(field, x, 1.0, torch.zeros(SCENES, 3, STEPS * 7), stride=None)
    assert torch.equal(kept, field)


@pytest.mark.parametrize("method", ["euler", "rk4"])
def test_anchors_that_graze_a_block_are_steered_clear(
    gaussian_flow: Callable, room: Any, plain: dict, method: str
) -> None:
    def clearance(**settings: Any) -> Tensor:
        config = GeneratorConfig(method=method, **plain, **settings)
        generator = TrajectoryGenerator(gaussian_flow(), config)
        return generator.generate(*room.ends, seed=0).clearance

    free, kept = clearance(), clearance(barrier_rate=5.0)
    assert float((free > 0).float().mean()) < 0.6
    assert float((kept > 0).float().mean()) > 0.95
    wider = clearance(barrier_rate=5.0, safety_margin=0.5)
    assert float(wider.median()) > float(kept.median()) + 0.2
    slower = clearance(barrier_rate=0.5)
    assert float(free.median()) < float(slower.median()) < float(kept.median())


def test_the_barrier_has_the_last_word_over_guidance(
    gaussian_flow: Callable, room: Any, plain: dict
) -> None:
    """A cost that pulls into the block."""
    generator = TrajectoryGenerator(
        gaussian_flow(), GeneratorConfig(barrier_rate=5.0, num_samples=16, **plain)
    )
    guidance = Guidance(lambda x: x[..., 1].square().mean(-1), 20.0)
    anchors = generator.generate(*room.ends, seed=0, guidance=guidance)
    assert float((anchors.clearance > 0).float().mean()) > 0.8


def test_a_rate_out_of_range_is_named() -> None:
    with pytest.raises(ValueError, match="barrier_rate: expected a number above 0, got 0"):
        GeneratorConfig(barrier_rate=0.0)
