"""The proof that a bundle computes what its network computes.

Every graph runs in onnxruntime and in torch on the same random inputs, and whole samples are drawn
by the service's engine with either.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.contract import resolve_for_card
from anchorflow_export.adapter import PlannerAdapter, Sizes
from anchorflow_export.tracing import ExportError
from anchorflow_models.torch_graphs import TorchGraphs
from anchorflow_service.bundle import Bundle
from anchorflow_service.bundle.graphs import OnnxGraphs
from anchorflow_service.engine import Engine
from anchorflow_service.engine.conditioning import CONDITIONINGS
from anchorflow_service.engine.interfaces import Arrays, Samples, names_of_each

Array = NDArray[Any]

TOLERANCE = 1e-4  # m of a sample's poses; of max(1, largest magnitude) for anything else
SEED = 11
THREADS = 2  # of the engine, so that samples are drawn in slices


@dataclass(frozen=True)
class Difference:
    """The largest difference between two computations of one thing."""

    what: str
    error: float

    def __str__(self) -> str:
        return f"{self.what}: {self.error:.2e}"


def prove_parity(
    adapter: PlannerAdapter, bundle: Bundle, *, tolerance: float = TOLERANCE
) -> tuple[Difference, ...]:
    """Compare a bundle's graphs and whole samples with the network.

    Raises what `within` raises, and `BundleError` if the engine refuses the bundle.
    """
    differences = [*graph_differences(adapter, bundle), *sample_differences(adapter, bundle)]
    return within(differences, tolerance)


def within(differences: Sequence[Difference], tolerance: float) -> tuple[Difference, ...]:
    """Return them; raise `ExportError` of those above the tolerance or not a number."""
    if wrong := [each for each in differences if not each.error <= tolerance]:  # a NaN fails
        numbers = "; ".join(map(str, wrong))
        raise ExportError(f"ONNX and torch differ by more than {tolerance:g}: {numbers}")
    return tuple(differences)


def graph_differences(adapter: PlannerAdapter, bundle: Bundle) -> Iterator[Difference]:
    """Run every graph at several sizes, each on outputs of torch's earlier graphs."""
    onnx, torch = OnnxGraphs(bundle), TorchGraphs(adapter.roles)
    for seed, sizes in enumerate(adapter.trials):
        given = scene_inputs(adapter, bundle, sizes, seed)
        own: Arrays = {}
        for name, role in adapter.roles.items():
            missing = [s for s in adapter.own if s.name in role.inputs and s.name not in own]
            missing = [s for s in missing if s.name not in adapter.scene_inputs]
            own |= adapter.draw(missing, given, sizes, seed) if missing else {}
            inputs = {each: np.ascontiguousarray({**given, **own}[each]) for each in role.inputs}
            expected, got = torch.run(name, inputs), onnx.run(name, inputs)
            what = f"{name} at {', '.join(f'{a}={n}' for a, n in sizes.items())}"
            yield _worst(what, got, _in_rows_of(got, expected, adapter.unordered.get(name, ())))
            specs = bundle.manifest.graphs[name].outputs
            given |= {s.name: _one_time(s, expected[s.name]) for s in specs}


def sample_differences(adapter: PlannerAdapter, bundle: Bundle) -> Iterator[Difference]:
    """Draw samples by the engine, with the bundle's graphs and with the network's."""
    served = Engine(bundle, threads=THREADS)
    network = Engine(bundle, threads=1, graphs=TorchGraphs(adapter.roles))
    for choice in adapter.samplers:
        request = replace(
            adapter.request(bundle.card, adapter.sample_sizes, SEED),
            num_samples=adapter.num_samples,
            seed=SEED,
            sampler=choice,
        )
        resolved = resolve_for_card(request, bundle.card)
        steps = f", {len(choice.schedule) - 1} steps" if choice and choice.schedule else ""
        scenes = zip(served.samples(resolved), network.samples(resolved), strict=True)
        for b, (got, expected) in enumerate(scenes):
            what, moved = f"sample of scene {b}{steps}", dict(expected.arrays)
            for names in adapter.unordered.values():
                if names[0] in moved:
                    rows = _nearest(got.arrays[names[0]], moved[names[0]])
                    moved |= {name: moved[name][rows] for name in names}
            expected = replace(expected, arrays=moved)
            yield from _sample_differences(what, bundle, got, expected)


def _sample_differences(
    what: str, bundle: Bundle, got: Samples, expected: Samples
) -> Iterator[Difference]:
    arrays, wanted, D = dict(got.arrays), dict(expected.arrays), bundle.manifest.D
    if bundle.manifest.sampler.kind != "ode" and "scores" in arrays:
        yield difference(f"{what}, the best first", arrays["scores"], wanted["scores"])
    # Nearly equal scores may be in either order, so match each anchor by its poses.
    rows = _nearest(got.states, expected.states)
    each = {*names_of_each(bundle.manifest.answer.extras), "scores"}
    wanted = {name: a[rows] if name in each else a for name, a in wanted.items()}
    states = expected.states[rows]
    yield difference(f"{what}, trajectories", got.states[..., :D], states[..., :D], relative=False)
    for column in range(D, states.shape[-1]):
        yield difference(f"{what}, state {column}", got.states[..., column], states[..., column])
    for name, array in arrays.items():
        yield difference(f"{what}, {name}", array, wanted[name])


def scene_inputs(adapter: PlannerAdapter, bundle: Bundle, sizes: Sizes, seed: int) -> Arrays:
    """Return the graphs' inputs that the scenes of a random request give, on a B axis."""
    if not adapter.scene_inputs:
        return {}
    request = resolve_for_card(adapter.request(bundle.card, sizes, seed), bundle.card)
    conditioning = CONDITIONINGS[bundle.manifest.conditioning.kind](bundle)
    scenes = [scene.inputs(adapter.scene_inputs) for scene in conditioning.scenes(request)]
    return {name: _stacked([scene[name] for scene in scenes]) for name in adapter.scene_inputs}


def _stacked(arrays: Sequence[Array]) -> Array:
    """Stack arrays [1,M,…] of scenes; the rows of one that has fewer are repeated."""
    rows = max(array.shape[1] if array.ndim > 1 else 1 for array in arrays)
    filled = [
        array[:, np.arange(rows) % array.shape[1]] if array.ndim > 1 else array for array in arrays
    ]
    return np.concatenate(filled)


def _one_time(spec: Any, array: Array) -> Array:
    """Return an output as a later graph takes it: at the last of its K times, if it has them."""
    if "K" not in spec.shape:
        return array
    return np.take(array, -1, axis=spec.shape.index("K"))


def _in_rows_of(got: Arrays, expected: Arrays, names: Sequence[str]) -> Arrays:
    """Return expected outputs [B,K,…] in the rows of others, told apart by the first of names."""
    if not names:
        return expected
    rows = [_nearest(*pair) for pair in zip(got[names[0]], expected[names[0]], strict=True)]
    moved = {n: np.stack([a[r] for a, r in zip(expected[n], rows, strict=True)]) for n in names}
    return expected | moved


def _nearest(got: Array, expected: Array) -> NDArray[np.intp]:
    """Return for each row of [N,…] the index of the nearest of [K,…]."""
    if got.shape[1:] != expected.shape[1:] or not len(expected):
        raise ExportError(f"ONNX gives shape {got.shape}, torch {expected.shape}")
    flat, others = got.reshape(len(got), -1), expected.reshape(len(expected), -1)
    return np.array([np.abs(others - row).max(-1).argmin() for row in flat], np.intp)


def _worst(what: str, got: Arrays, expected: Arrays) -> Difference:
    """Return the largest difference of a graph's outputs."""
    parts = [difference(f"{what}, {name}", got[name], expected[name]) for name in got]
    # A NaN compares as the worst.
    return max(parts, key=lambda part: np.nan_to_num(part.error, nan=np.inf))


def difference(what: str, got: Array, expected: Array, *, relative: bool = True) -> Difference:
    """Return the largest difference, unless not `relative` of max(1, the largest magnitude)."""
    if got.shape != expected.shape:
        raise ExportError(f"{what}: ONNX gives shape {got.shape}, torch {expected.shape}")
    # Bytes and truth values would wrap in their own type.
    made, wanted = got.astype(np.float64), expected.astype(np.float64)
    scale = max(1.0, float(np.abs(wanted).max())) if relative else 1.0
    return Difference(what, float(np.abs(made - wanted).max()) / scale)
