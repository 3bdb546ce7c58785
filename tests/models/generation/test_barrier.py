"""The control barrier and the clearance that it reads: condition, gradients, anchors with room."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from flowmp_scenes import PLAIN, ROOM, GaussianFlow
from torch import Tensor

from anchorflow_models.generation import (
    ClearanceMap,
    GeneratorConfig,
    Guidance,
    TrajectoryGenerator,
)
from anchorflow_models.generation.steering import SLACK, Barrier
from anchorflow_trajectory.cost.clearance import GridField, clearance_field

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


@pytest.mark.parametrize("method", ["euler", "rk4"])
def test_anchors_that_graze_a_block_are_steered_clear(method: str) -> None:
    def clearance(**settings: Any) -> Tensor:
        config = GeneratorConfig(method=method, **PLAIN, **settings)
        generator = TrajectoryGenerator(GaussianFlow(), config)
        return generator.generate(*ROOM.ends, seed=0).clearance

    free, kept = clearance(), clearance(barrier_rate=5.0)
    assert float((free > 0).float().mean()) < 0.6
    assert float((kept > 0).float().mean()) > 0.95
    wider = clearance(barrier_rate=5.0, safety_margin=0.5)
    assert float(wider.median()) > float(kept.median()) + 0.2
    slower = clearance(barrier_rate=0.5)
    assert float(free.median()) < float(slower.median()) < float(kept.median())


def test_the_barrier_has_the_last_word_over_guidance() -> None:
    """A cost that pulls into the block."""
    generator = TrajectoryGenerator(
        GaussianFlow(), GeneratorConfig(barrier_rate=5.0, num_samples=16, **PLAIN)
    )
    guidance = Guidance(lambda x: x[..., 1].square().mean(-1), 20.0)
    anchors = generator.generate(*ROOM.ends, seed=0, guidance=guidance)
    assert float((anchors.clearance > 0).float().mean()) > 0.8


def test_a_rate_out_of_range_is_named() -> None:
    with pytest.raises(ValueError, match="barrier_rate: expected a number above 0, got 0"):
        GeneratorConfig(barrier_rate=0.0)


def test_values_and_gradients_are_those_of_the_service() -> None:
    rng = np.random.default_rng(0)
    maps = [clearance_field(rng.random((30, 20)) < 0.05, 0.2, 0.1) for _ in range(2)]
    geometry = torch.tensor([[-1.0, 2.0, 0.2], [3.0, -4.0, 0.2]])
    corner = geometry[:, None, :2].numpy()
    # Some lie beyond the map on either side.
    points = (corner + rng.uniform([-1, -1], [5, 7], (2, 200, 2))).astype(np.float32)
    x = torch.tensor(points).reshape(2, 10, 20, 2).requires_grad_()
    got = ClearanceMap(torch.from_numpy(np.stack(maps)), geometry)(x)
    (gradient,) = torch.autograd.grad(got.sum(), x)
    for b, values in enumerate(maps):
        field = GridField(values, 0.2, corner[b, 0].astype(np.float64))
        value, *slopes = field.sample_with_gradient(points[b, :, 0], points[b, :, 1])
        np.testing.assert_allclose(got[b].detach().reshape(-1), value, atol=1e-5)
        inside = ((points[b] > corner[b] + 0.1) & (points[b] < corner[b] + (3.9, 5.9))).all(-1)
        slopes_here = gradient[b].reshape(-1, 2)[inside]
        np.testing.assert_allclose(slopes_here.T, np.array(slopes)[:, inside], atol=5e-5)


def test_beyond_the_map_the_way_back_is_uphill() -> None:
    clearance = ClearanceMap(torch.zeros(1, 10, 10), torch.tensor([[0.0, 0.0, 1.0]]))
    x = torch.tensor([[[-1.5, 5.0], [5.0, 12.0]]]).requires_grad_()
    got = clearance(x)
    assert got.tolist() == [[-2.0, -2.5]]
    (gradient,) = torch.autograd.grad(got.sum(), x)
    assert gradient.tolist() == [[[1.0, 0.0], [0.0, -1.0]]]
