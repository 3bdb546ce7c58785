"""Warm starts: a known trajectory in place of most of the noise."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from anchorflow_client.contract import AnchorRequest, WarmStart
from anchorflow_client.errors import InvalidRequest
from anchorflow_service.engine.samplers.warm_start import warm_state
from anchorflow_service.local import LocalClient

HORIZON = 7.0


def parabola(steps: int) -> np.ndarray:
    """States [steps,6] of a trajectory that splines represent exactly."""
    t = np.linspace(0.0, HORIZON, steps)
    p = [0.5 * t**2 - t, 0.1 * t**2]
    v = [t - 1.0, 0.2 * t]
    a = [np.ones_like(t), 0.2 * np.ones_like(t)]
    return np.stack([*p, *v, *a], axis=1)


@pytest.mark.parametrize("columns", [2, 4, 6])
@pytest.mark.parametrize("steps", [4, 8, 31])
def test_missing_derivatives_and_steps_are_filled(steps: int, columns: int) -> None:
    warm = WarmStart(parabola(steps)[:, :columns], tau=0.8)
    got = warm_state(warm, dim=2, num_steps=8, horizon_s=HORIZON)
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, parabola(8), atol=1e-5)


def turning(steps: int) -> np.ndarray:
    """States [steps,9] with a heading that splines represent exactly too."""
    t = np.linspace(0.0, HORIZON, steps)
    heading = [0.05 * t**2 + 0.3, 0.1 * t, np.full_like(t, 0.1)]
    planar = parabola(steps)
    columns = [(planar[:, 2 * k : 2 * k + 2], heading[k][:, None]) for k in range(3)]
    return np.concatenate([part for pair in columns for part in pair], axis=1)


@pytest.mark.parametrize("columns", [3, 6, 9])
def test_six_columns_are_velocities_too_where_the_card_has_a_heading(
    columns: int,
) -> None:
    warm = WarmStart(turning(31)[:, :columns], tau=0.8)
    got = warm_state(warm, dim=3, num_steps=8, horizon_s=HORIZON)
    np.testing.assert_allclose(got, turning(8), atol=1e-5)


@pytest.mark.parametrize("columns", [4, 5, 7, 8])
def test_a_part_of_a_vector_is_refused(columns: int) -> None:
    warm = WarmStart(np.zeros((8, columns)), tau=0.8)
    with pytest.raises(InvalidRequest, match=rf"3, 6, 9 columns\), got {columns}") as caught:
        warm_state(warm, dim=3, num_steps=8, horizon_s=HORIZON)
    assert caught.value.field == "warm_start.trajectory"


def test_the_flow_goes_on_from_tau(
    tiny_bundle: Path, small_request: Callable[..., AnchorRequest]
) -> None:
    """x_tau = tau x_1 + (1 - tau) x_0, and the field's 4 t³ moves the rest: 1 - tau⁴."""
    tau = 0.75
    trajectory = parabola(8) * 0.1
    batch = LocalClient.of(tiny_bundle, threads=1).plan_request(
        small_request(
            warm_start={"trajectory": trajectory, "tau": tau},
            refine={"smooth": False, "project": False},
        )
    )
    noise = np.random.Generator(np.random.PCG64(7)).standard_normal((20, 2), dtype=np.float32)
    x_0 = np.array([-3.0, 0.1]) + 0.1 * noise[:, :1]
    moved = np.array([4 / 256, 1.0]) * (1 - tau**4)
    expected = tau * trajectory[:, :2] + (1 - tau) * x_0[:, None] + moved
    np.testing.assert_allclose(batch.trajectories, expected, atol=1e-5)
