"""The flow sampler on a bundle whose answer is known in closed form."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from anchorflow_client.contract import EIGHT_STEP_SCHEDULE, OdeSpec
from anchorflow_service.bundle import load_bundle
from anchorflow_service.engine.parts import Arrays, Context
from anchorflow_service.engine.samplers.ode import OdeSampler

RK4_8STEP = OdeSpec("rk4", EIGHT_STEP_SCHEDULE)
X_CURR = np.array([[1.0, 2.0, 0.5, -0.5, 0.0, 0.1]], np.float32)
MEANS = np.array([0.25, 1.0, 0.5], np.float32)


@pytest.fixture
def flow(tiny_bundle: Path) -> OdeSampler:
    return OdeSampler(load_bundle(tiny_bundle), threads=2)


class Given:
    """A scene of the graphs' own inputs."""

    request: Any = None

    def inputs(self, names: Iterable[str]) -> Arrays:
        cost_map = np.broadcast_to(MEANS[:, None, None], (3, 20, 18))[None]
        given = {"cost_map": np.ascontiguousarray(cost_map), "x_curr": X_CURR}
        return {name: given[name] for name in names}

    def answered(self, arrays: Arrays) -> Arrays:
        return arrays


def encode(flow: OdeSampler) -> Context:
    return flow.encode(Given())


def sample(flow: OdeSampler, num_samples: int, seed: int) -> np.ndarray:
    context = encode(flow)
    noise = flow.draw_noise(context, num_samples=num_samples, seed=seed)
    return flow.integrate(context, flow.initial_state(context, noise), RK4_8STEP)


def test_encode_prior_modulation_and_field_meet(flow: OdeSampler) -> None:
    noise = np.random.Generator(np.random.PCG64(3)).standard_normal((20, 2), dtype=np.float32)
    spread = 0.1 * np.repeat(noise, [2, 2], axis=1)
    x_1 = X_CURR + np.tile(MEANS, 2) + np.pad(spread, ((0, 0), (0, 2)))
    expected = np.repeat(x_1[:, None], 8, axis=1)
    got = sample(flow, 20, seed=3)
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, expected, atol=2e-6)


@pytest.mark.parametrize("num_samples", [1, 8, 9, 31])
def test_every_number_of_anchors_can_be_cut_into_slices(flow: OdeSampler, num_samples: int) -> None:
    """Slices keep their order: the first anchors of a seed stay where they are."""
    many = sample(flow, 31, seed=5)
    np.testing.assert_allclose(sample(flow, num_samples, seed=5), many[:num_samples], atol=1e-6)


def test_euler_on_the_same_field_has_its_own_answer(flow: OdeSampler) -> None:
    """Euler sees 4 t³ at the start of each step only."""
    context = encode(flow)
    x = np.zeros((3, 8, 6), np.float32)
    got = flow.integrate(context, x, OdeSpec("euler", (0.0, 0.5, 1.0)))
    np.testing.assert_allclose(got[0, 0], np.tile(MEANS, 2) * 4 * 0.5**3 * 0.5, atol=1e-6)


def test_a_schedule_may_start_late(flow: OdeSampler) -> None:
    """From tau the field carries the rest of the way: 1 - tau⁴."""
    x = np.zeros((3, 8, 6), np.float32)
    got = flow.integrate(encode(flow), x, OdeSpec("rk4", EIGHT_STEP_SCHEDULE[1:]))
    np.testing.assert_allclose(got[2, 5], np.tile(MEANS, 2) * (1 - 0.8**4), atol=1e-6)


def test_without_a_prior_the_flow_starts_from_plain_noise(
    tiny_bundle: Path, edit_manifest: Callable[..., None]
) -> None:
    edit_manifest("sampler", "prior", to=None)
    flow = OdeSampler(load_bundle(tiny_bundle), threads=1)
    context = encode(flow)
    noise = flow.draw_noise(context, num_samples=4, seed=1)
    assert noise.shape == (4, 8, 6)
    assert flow.initial_state(context, noise) is noise


def test_several_threads_may_sample_at_once(flow: OdeSampler) -> None:
    alone = [sample(flow, 40, seed) for seed in range(6)]
    with ThreadPoolExecutor(6) as pool:
        together = list(pool.map(lambda seed: sample(flow, 40, seed), range(6)))
    np.testing.assert_array_equal(together, alone)
