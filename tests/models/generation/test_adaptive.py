"""The adaptive solver rk45: its tolerance, its cost, and the hardest of many samples."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from anchorflow_models.generation.generator import integrate_adaptive

X_0 = torch.tensor([[[0.1, 0.3], [0.5, 0.7]]], dtype=torch.float64)


def slope(t: float | Tensor, x: Tensor) -> Tensor:
    """dx/dt = 3 (1 + t) x (1 - x): nonlinear, time-dependent, and solved in closed form."""
    return 3 * (1 + t) * x * (1 - x)


def exact(x_0: Tensor, start: float = 0.0) -> Tensor:
    growth = 3 * (1.5 - start - start**2 / 2)
    return 1 / (1 + (1 / x_0 - 1) * math.exp(-growth))


@pytest.mark.parametrize("tolerance", [1e-3, 1e-6, 1e-9])
def test_the_adaptive_method_meets_its_tolerance(tolerance: float) -> None:
    evaluations = 0

    def field(t: Tensor, x: Tensor) -> Tensor:
        nonlocal evaluations
        evaluations += 1
        return slope(t, x)

    for start in (0.0, 0.6):
        got = integrate_adaptive(field, X_0, start=start, rtol=tolerance, atol=tolerance)
        assert float((got - exact(X_0, start)).abs().max()) < 5 * tolerance
    # Order 5: a thousandth of the error costs about four times the steps, not a thousand times.
    assert evaluations < 30 * 4 ** (-math.log10(tolerance) / 3)


def test_one_hard_sample_among_many_is_solved_as_if_alone() -> None:
    """Averaged over all samples its error would count for a thousandth."""

    def solved(rates: Tensor) -> Tensor:
        return integrate_adaptive(
            lambda t, x: rates * torch.cos(rates * t) * x,
            torch.ones_like(rates),
            start=0.0,
            rtol=1e-5,
            atol=1e-5,
        )

    hard = torch.full((1, 1, 1), 40.0, dtype=torch.float64)
    among_many = solved(torch.cat([hard, torch.zeros(1, 999, 1, dtype=torch.float64)], 1))
    torch.testing.assert_close(among_many[:, :1], solved(hard), rtol=1e-12, atol=0)


def test_a_tolerance_finer_than_the_numbers_is_refused() -> None:
    with pytest.raises(ValueError, match=r"rtol: expected at least 1\.2e-06 for torch\.float32"):
        integrate_adaptive(slope, X_0.float(), start=0.0, rtol=1e-7, atol=1e-7)
