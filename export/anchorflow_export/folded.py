"""Weights that a graph holds only in what the exporter computed from them.

Each function reads them into a network whose other weights are read already, and returns the names
of those that it has set.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import onnx
import torch
from onnx import numpy_helper
from torch import nn

from anchorflow_export.adapter import PlannerAdapter
from anchorflow_export.parity import scene_inputs
from anchorflow_export.tracing import ExportError
from anchorflow_models.diffusiondrive import DiffusionDriveV2
from anchorflow_models.flowmp import L2SafetyCFM
from anchorflow_models.torch_graphs import TorchGraphs
from anchorflow_models.wote import WoTE
from anchorflow_service.bundle import Bundle
from anchorflow_service.bundle.graphs import OnnxGraphs
from anchorflow_service.engine.interfaces import Arrays

Adapt = Callable[[], PlannerAdapter]
"""Adapts the network as it stands, with the choices of the bundle."""

HORIZON = 3  # of limits
EVALUATIONS = 400  # of L-BFGS on the encoder of anchors


def noise(bundle: Bundle, model: L2SafetyCFM, adapt: Adapt) -> set[str]:
    """Solve for FlowMP's noise: the basis of each scene is linear in its factor."""
    factor = model.prior.factor
    factor.copy_(torch.eye(len(factor)))
    adapter = adapt()
    inputs = _encode_inputs(bundle, adapter)
    inputs["limits"][:, HORIZON] = 0.0  # open, or the basis would leave out durations
    own, held = (
        graphs.run("encode", inputs)["prior_basis"][0].astype(np.float64)
        for graphs in (TorchGraphs(adapter.roles), OnnxGraphs(bundle))
    )
    factor.copy_(torch.from_numpy(np.linalg.lstsq(own.T, held.T, rcond=None)[0].T))
    return {"prior.factor", "prior.free"}


def anchors(bundle: Bundle, model: DiffusionDriveV2, adapt: Adapt) -> set[str]:
    """Take DiffusionDriveV2's anchors from what encode gives, in the diffusion's units."""
    held = OnnxGraphs(bundle).run("encode", _encode_inputs(bundle, adapt()))["anchors"][0]
    space = model.denoiser.space
    model.anchors.copy_(torch.from_numpy(held) * space.scale + space.middle)
    return {"anchors"}


def anchor_encoder(bundle: Bundle, model: WoTE, _adapt: Adapt) -> set[str]:
    """Fit WoTE's encoder to the encoded anchors, which are all that a graph holds of it.

    What the fit leaves over is kept as the network's `anchor_remainder`.
    """
    wanted = torch.from_numpy(_encoded_anchors(bundle, [*model.encoded_anchors().shape]))
    parts = {"to_anchor": model.to_anchor, "anchor_encoder": model.anchor_encoder}
    learnt = [each for part in parts.values() for each in part.parameters()]
    with torch.enable_grad():
        optimiser = torch.optim.LBFGS(
            learnt, max_iter=EVALUATIONS, max_eval=EVALUATIONS, line_search_fn="strong_wolfe"
        )

        def loss() -> float:
            optimiser.zero_grad()
            apart = nn.functional.mse_loss(model.encoded_anchors(), wanted)
            apart.backward()
            return float(apart.detach())

        optimiser.step(loss)
    model.anchor_remainder.copy_(wanted - model.encoded_anchors())
    names = (
        f"{name}.{each}" for name, part in parts.items() for each, _ in part.named_parameters()
    )
    return {"anchor_remainder", *names}


def _encoded_anchors(bundle: Bundle, shape: list[int]) -> np.ndarray:
    for each in onnx.load(bundle.graph_path("score")).graph.initializer:
        if each.name.endswith("anchors") and [*each.dims] == shape:
            return numpy_helper.to_array(each).copy()
    raise ExportError(f"score: expected encoded anchors of shape {shape}, found none")


def _encode_inputs(bundle: Bundle, adapter: PlannerAdapter) -> Arrays:
    """Return what the graph encode takes of a random scene."""
    given = scene_inputs(adapter, bundle, adapter.trials[0], 0)
    return {name: np.array(given[name]) for name in adapter.roles["encode"].inputs}


FOLDED: Mapping[str, Callable[[Bundle, Any, Adapt], set[str]]] = {
    "flowmp": noise,
    "diffusiondrive": anchors,
    "wote": anchor_encoder,
}
