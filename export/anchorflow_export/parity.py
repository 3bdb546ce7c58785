"""The proof: every graph, and a whole sample through the service's engine, against torch."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from anchorflow_client.contract import SamplerSpec
from anchorflow_export.errors import ExportError
from anchorflow_export.graphs import PRIOR_BASIS, PRIOR_MEAN, Context, FlowModel
from anchorflow_export.scenes import random_scenes
from anchorflow_service.bundle import Bundle
from anchorflow_service.bundle.graphs import Graph, open_graph
from anchorflow_service.engine.samplers.ode import FlowSampler
from anchorflow_trajectory.ode.method import Method, method_named
from anchorflow_trajectory.ode.reference import integrate_plainly

TOLERANCE = 1e-4  # m, m/s, m/s² of a sample; of max(1, largest magnitude) for a graph's outputs

Arrays = dict[str, np.ndarray]


@dataclass(frozen=True)
class Trial:
    """Sizes that a graph is tried at; none is the one it was traced at."""

    B: int
    N: int
    K: int
    H: int
    W: int


TRIALS = (Trial(1, 1, 17, 64, 64), Trial(3, 5, 1, 16, 40), Trial(2, 64, 8, 97, 50))
SAMPLE_TRIAL = Trial(2, 9, 0, 64, 48)  # N enough for two slices


@dataclass(frozen=True)
class Difference:
    """How far two computations of one thing are apart at worst."""

    what: str
    error: float

    def __str__(self) -> str:
        return f"{self.what}: {self.error:.2e}"


def prove_parity(
    model: FlowModel, bundle: Bundle, *, tolerance: float = TOLERANCE
) -> tuple[Difference, ...]:
    """Compare a bundle's graphs and a whole sample with the torch model.

    Raises:
        ExportError: a difference is above the tolerance, or not a number; it lists all of them.
    """
    with torch.inference_mode():
        graphs = [d for seed, t in enumerate(TRIALS) for d in _graphs(model, bundle, t, seed)]
        differences = (*graphs, *_samples(model, bundle, SAMPLE_TRIAL))
    # Written so that a NaN fails.
    if not all(difference.error <= tolerance for difference in differences):
        numbers = "; ".join(str(difference) for difference in differences)
        raise ExportError(f"ONNX and torch differ by more than {tolerance:g}: {numbers}")
    return differences


def torch_sample(
    model: FlowModel,
    context: Context,
    x: Tensor,
    *,
    schedule: tuple[float, ...],
    method: Method,
) -> Tensor:
    """The sampler written the plain way, one modulation an evaluation: x_0 -> x_1 [B,N,T,S]."""

    def field(x_t: Tensor, t: float) -> Tensor:
        modulation = model.modulate(torch.tensor([t]), context)[:, 0]
        return model.field(x_t, modulation, context)

    return integrate_plainly(field, x, schedule=schedule, method=method)


def _graphs(model: FlowModel, bundle: Bundle, trial: Trial, seed: int) -> Iterator[Difference]:
    """encode, modulate and field at one set of sizes, each fed from torch's own context."""
    generator = torch.Generator().manual_seed(seed)
    inputs = _scenes(bundle, trial, seed)
    context = model.encode(**inputs)
    encode = open_graph(bundle, "encode")
    yield _compare(f"encode at {trial}", encode, inputs, context)

    times = torch.rand(trial.K, generator=generator).sort().values
    modulation = model.modulate(times, context)
    modulate = open_graph(bundle, "modulate")
    yield _compare(
        f"modulate at {trial}", modulate, {**context, "times": times}, {"modulation": modulation}
    )

    noise = torch.randn(trial.N, context[PRIOR_BASIS].shape[1], generator=generator)
    x_t, one_time = _initial_state(context, noise), modulation[:, -1]
    field_inputs = {**context, "x_t": x_t, "modulation": one_time}
    expected = {"dx_t": model.field(x_t, one_time, context)}
    yield _compare(f"field at {trial}", open_graph(bundle, "field"), field_inputs, expected)


def _samples(model: FlowModel, bundle: Bundle, trial: Trial) -> Iterator[Difference]:
    """The card's sampler from the same noise: the plain torch loop and the engine's."""
    card, flow = bundle.card, FlowSampler(bundle, threads=2)
    inputs = _scenes(bundle, trial, len(TRIALS))
    context = model.encode(**inputs)
    sampler: SamplerSpec = card.sampler
    for b in range(trial.B):
        scene = flow.encode({name: array[b : b + 1].numpy() for name, array in inputs.items()})
        noise = flow.draw_noise(scene, num_samples=trial.N, seed=b)
        state = flow.integrate(scene, flow.initial_state(scene, noise), sampler)
        expected = torch_sample(
            model,
            {name: tensor[b : b + 1] for name, tensor in context.items()},
            _initial_state(context, torch.from_numpy(noise))[b : b + 1],
            schedule=sampler.schedule,
            method=method_named(sampler.method),
        )
        yield _difference(f"sample of scene {b} at {trial}", state, expected[0].numpy())


def _scenes(bundle: Bundle, trial: Trial, seed: int) -> dict[str, Tensor]:
    return random_scenes(bundle.card, scenes=trial.B, height=trial.H, width=trial.W, seed=seed)


def _initial_state(context: Context, noise: Tensor) -> Tensor:
    """x_0 [B,N,T,S] from noise [N,R]."""
    mean = context[PRIOR_MEAN]
    return mean[:, None] + (noise @ context[PRIOR_BASIS]).unflatten(-1, mean.shape[1:])


def _compare(what: str, graph: Graph, inputs: Context, expected: Context) -> Difference:
    """The worst of a graph's outputs."""
    arrays = {name: tensor.contiguous().numpy() for name, tensor in inputs.items()}
    got = graph(**graph.select(arrays))
    parts = [
        _difference(f"{what}, {name}", got[name], expected[name].numpy(), relative=True)
        for name in got
    ]
    # A NaN compares as the worst.
    return max(parts, key=lambda part: np.nan_to_num(part.error, nan=np.inf))


def _difference(
    what: str, got: np.ndarray, expected: np.ndarray, *, relative: bool = False
) -> Difference:
    if got.shape != expected.shape:
        raise ExportError(f"{what}: ONNX gives shape {got.shape}, torch {expected.shape}")
    scale = max(1.0, float(np.abs(expected).max())) if relative else 1.0
    return Difference(what, float(np.abs(got - expected).max()) / scale)
