"""Where a flow starts: from a mean of the encoder, or from plain noise.

What it answers in closed form is in `test_engine.py` and `test_own_durations.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from anchorflow_service.bundle import load_bundle
from anchorflow_service.bundle.graphs import OnnxGraphs
from anchorflow_service.engine.interfaces import Arrays
from anchorflow_service.engine.samplers.ode import OdeSampler

X_CURR = np.array([[1.0, 2.0, 0.5, -0.5, 0.0, 0.1]], np.float32)
MEANS = np.array([0.25, 1.0, 0.5], np.float32)
ROUTES = np.random.default_rng(0).normal(size=(3, 8, 7)).astype(np.float32)


def opened(folder: Path) -> OdeSampler:
    bundle = load_bundle(folder)
    return OdeSampler(bundle.manifest, OnnxGraphs(bundle, threads=1), threads=1)


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


def drawn(num_samples: int, seed: int) -> np.ndarray:
    """What noise adds to the means, [N,7]."""
    generator = np.random.Generator(np.random.PCG64(seed))
    noise = generator.standard_normal((num_samples, 3), dtype=np.float32)
    return 0.1 * np.insert(noise, [1, 2, 2, 2], noise[:, [0, 1, 1, 1]] * [1, 1, 0, 0], axis=1)


def test_a_mean_that_encode_gives_is_every_anchors(
    tiny_bundle: Path, edit_manifest: Callable[..., None]
) -> None:
    encoded = opened(tiny_bundle).encode(Given())
    edit_manifest("sampler.prior.mean", to="own_mean")
    flow = opened(tiny_bundle)
    context = {**encoded, "own_mean": ROUTES[:1]}
    begun = flow.beginning(context, flow.draw_noise(context, num_samples=4, seed=1))
    np.testing.assert_allclose(begun.x - drawn(4, seed=1)[:, None], ROUTES[[0] * 4], atol=1e-6)
    assert (begun.route.any(), begun.mean) == (False, None)


def test_without_a_prior_the_flow_starts_from_plain_noise(
    tiny_bundle: Path, edit_manifest: Callable[..., None]
) -> None:
    edit_manifest("sampler.prior", to=None)
    flow = opened(tiny_bundle)
    context = flow.encode(Given())
    noise = flow.draw_noise(context, num_samples=4, seed=1)
    assert noise.shape == (4, 8, 7)
    assert flow.beginning(context, noise).x is noise
