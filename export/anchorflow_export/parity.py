"""The proof: every graph, and whole samples through the service's sampler, against torch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from anchorflow_export.adapter import GraphTrial, PlannerAdapter
from anchorflow_export.errors import ExportError
from anchorflow_service.bundle import Bundle
from anchorflow_service.bundle.graphs import open_graph

TOLERANCE = 1e-4  # m, m/s, m/s² of a sample; of max(1, largest magnitude) for a graph's outputs


@dataclass(frozen=True)
class Difference:
    """How far two computations of one thing are apart at worst."""

    what: str
    error: float

    def __str__(self) -> str:
        return f"{self.what}: {self.error:.2e}"


def prove_parity(
    adapter: PlannerAdapter, bundle: Bundle, *, tolerance: float = TOLERANCE
) -> tuple[Difference, ...]:
    """Compare a bundle's graphs and whole samples with the torch model.

    Raises:
        ExportError: differences are above the tolerance, or not a number; it lists them.
    """
    with torch.inference_mode():
        differences = (
            *(_compare(bundle, trial) for trial in adapter.graph_trials(bundle)),
            *(
                _difference(trial.what, trial.got, trial.expected, relative=trial.relative)
                for trial in adapter.sample_trials(bundle)
            ),
        )
    # Written so that a NaN fails.
    if wrong := [each for each in differences if not each.error <= tolerance]:
        numbers = "; ".join(map(str, wrong))
        raise ExportError(f"ONNX and torch differ by more than {tolerance:g}: {numbers}")
    return differences


def _compare(bundle: Bundle, trial: GraphTrial) -> Difference:
    """The worst of a graph's outputs."""
    graph = open_graph(bundle, trial.role)
    arrays = {name: tensor.contiguous().numpy() for name, tensor in trial.inputs.items()}
    got = graph(**graph.select(arrays))
    parts = [
        _difference(f"{trial.what}, {name}", got[name], trial.expected[name].numpy(), relative=True)
        for name in got
    ]
    # A NaN compares as the worst.
    return max(parts, key=lambda part: np.nan_to_num(part.error, nan=np.inf))


def _difference(
    what: str, got: np.ndarray, expected: np.ndarray, *, relative: bool = False
) -> Difference:
    if got.shape != expected.shape:
        raise ExportError(f"{what}: ONNX gives shape {got.shape}, torch {expected.shape}")
    # Whole numbers and truth values too: bytes would wrap in their own type.
    told, wanted = got.astype(np.float64), expected.astype(np.float64)
    scale = max(1.0, float(np.abs(wanted).max())) if relative else 1.0
    return Difference(what, float(np.abs(told - wanted).max()) / scale)
