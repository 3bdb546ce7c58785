"""The flow sampler on a bundle whose answer is known in closed form."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from anchorflow_client.contract import EIGHT_STEP_SCHEDULE, OdeSpec
from anchorflow_service.bundle import load_bundle
from anchorflow_service.bundle.graphs import OnnxGraphs
from anchorflow_service.engine.interfaces import Arrays, Context
from anchorflow_service.engine.samplers.flow import Beginning
from anchorflow_service.engine.samplers.ode import OdeSampler

RK4_8STEP = OdeSpec("rk4", EIGHT_STEP_SCHEDULE)
X_CURR = np.array([[1.0, 2.0, 0.5, -0.5, 0.0, 0.1]], np.float32)
MEANS = np.array([0.25, 1.0, 0.5], np.float32)
CARRIED = np.array([0.25, 1.0, 0.5, 0.25, 1.0, 0.5, 0.0], np.float32)
PULL = np.array([0.0, 0.0, 0.5, 0.5, 0.0, 0.0, 0.0], np.float32)
ROUTES = np.random.default_rng(0).normal(size=(3, 8, 7)).astype(np.float32)


@pytest.fixture
def flow(tiny_bundle: Path) -> OdeSampler:
    return opened(tiny_bundle, threads=2)


def opened(folder: Path, *, threads: int) -> OdeSampler:
    bundle = load_bundle(folder)
    return OdeSampler(bundle.manifest, OnnxGraphs(bundle, threads=threads), threads=threads)


class Given:
    """A scene of the graphs' own inputs."""

    request: Any = None

    def inputs(self, names: Iterable[str]) -> Arrays:
        cost_map = np.broadcast_to(MEANS[:, None, None], (3, 20, 18))[None]
        given = {
            "cost_map": np.ascontiguousarray(cost_map),
            "x_curr": X_CURR,
            "route_states": ROUTES[None],
        }
        return {name: given[name] for name in names}

    def answered(self, arrays: Arrays) -> Arrays:
        return arrays


def encode(flow: OdeSampler) -> Context:
    return flow.encode(Given())


def begin(flow: OdeSampler, num_samples: int, seed: int) -> Beginning:
    context = encode(flow)
    noise = flow.draw_noise(context, num_samples=num_samples, seed=seed)
    return flow.beginning(context, noise)


def drawn(num_samples: int, seed: int) -> np.ndarray:
    """What noise adds to the means, [N,7]."""
    generator = np.random.Generator(np.random.PCG64(seed))
    noise = generator.standard_normal((num_samples, 3), dtype=np.float32)
    return 0.1 * np.insert(noise, [1, 2, 2, 2], noise[:, [0, 1, 1, 1]] * [1, 1, 0, 0], axis=1)


def test_encode_prior_modulation_and_field_meet(flow: OdeSampler) -> None:
    mean = ROUTES[np.arange(20) % 3]
    expected = mean * (1 + PULL) + CARRIED + drawn(20, seed=3)[:, None]
    got = flow.integrate(encode(flow), begin(flow, 20, seed=3), RK4_8STEP)
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, expected, atol=5e-6)


def test_anchors_are_dealt_out_over_the_routes_in_turn(flow: OdeSampler) -> None:
    begun = begin(flow, 8, seed=3)
    assert begun.mean is not None
    np.testing.assert_array_equal(begun.route, [0, 1, 2, 0, 1, 2, 0, 1])
    np.testing.assert_array_equal(begun.mean, ROUTES[begun.route])
    spread = np.broadcast_to(drawn(8, seed=3)[:, None], begun.x.shape)
    np.testing.assert_allclose(begun.x - begun.mean, spread, atol=1e-6)


@pytest.mark.parametrize(
    ("sampler", "share"),
    [
        (RK4_8STEP, 1.0),
        (OdeSpec("rk4", EIGHT_STEP_SCHEDULE[1:]), 1 - 0.8**4),
        (OdeSpec("euler", (0.0, 0.5, 1.0)), 4 * 0.5**3 * 0.5),
    ],
    ids=["rk4", "late start", "euler"],
)
def test_the_field_carries_as_far_as_a_method_and_its_schedule_say(
    flow: OdeSampler, sampler: OdeSpec, share: float
) -> None:
    """4 t³ from a flow time to 1; Euler sees it at the start of each step only."""
    zeros = np.zeros((3, 8, 7), np.float32)  # on a route of zeros nothing else moves them
    got = flow.integrate(encode(flow), Beginning(zeros, np.zeros(3, np.intp), zeros), sampler)
    np.testing.assert_allclose(got, np.broadcast_to(CARRIED * share, got.shape), atol=1e-6)


def test_a_mean_that_encode_gives_is_every_anchors(
    tiny_bundle: Path, edit_manifest: Callable[..., None]
) -> None:
    encoded = encode(opened(tiny_bundle, threads=1))
    edit_manifest("sampler.prior.mean", to="own_mean")
    flow = opened(tiny_bundle, threads=1)
    context = {**encoded, "own_mean": ROUTES[:1]}
    begun = flow.beginning(context, flow.draw_noise(context, num_samples=4, seed=1))
    np.testing.assert_allclose(begun.x - drawn(4, seed=1)[:, None], ROUTES[[0] * 4], atol=1e-6)
    assert (begun.route.any(), begun.mean) == (False, None)


def test_without_a_prior_the_flow_starts_from_plain_noise(
    tiny_bundle: Path, edit_manifest: Callable[..., None]
) -> None:
    edit_manifest("sampler.prior", to=None)
    flow = opened(tiny_bundle, threads=1)
    context = encode(flow)
    noise = flow.draw_noise(context, num_samples=4, seed=1)
    assert noise.shape == (4, 8, 7)
    assert flow.beginning(context, noise).x is noise
