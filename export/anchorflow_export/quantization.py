"""Products of the field and convolutions of the encoder in eight bits: a third faster.

Weights are rounded once, a column at a time, activations by scales that random scenes gave. So an
anchor is rounded alike whichever anchors are beside it, which scales of each call would not do.
"""

from __future__ import annotations

import hashlib
import logging
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnxruntime.quantization import (
    CalibrationDataReader,
    QuantFormat,
    QuantType,
    quantize_static,
)

from anchorflow_client.contract import OdeSpec
from anchorflow_export.bundle import into_place
from anchorflow_export.errors import ExportError
from anchorflow_export.parity import Difference
from anchorflow_export.planners.flowmp.adapter import SAMPLE_TRIAL
from anchorflow_export.planners.flowmp.scenes import random_scenes
from anchorflow_service.bundle import Bundle, load_bundle
from anchorflow_service.bundle.graphs import open_graph
from anchorflow_service.bundle.manifest import FILE_NAME, CostMapEntry, GraphEntry
from anchorflow_service.engine.conditioning.cost_map import MapScene
from anchorflow_service.engine.parts import Arrays
from anchorflow_service.engine.samplers.flow_score import PRIOR_MEAN
from anchorflow_service.engine.samplers.ode import OdeSampler

SCENES = 4
CALIBRATION = 16  # scenes
TRIAL_SHAPE = (SAMPLE_TRIAL.H, SAMPLE_TRIAL.W)
ROUNDED = {"encode": ("Conv", 0), "field": ("MatMul", 1)}
"""Nodes in eight bits, by graph, but for so many at its beginning: the field's first product reads
states, whose numbers are of all sizes, and rounded it moves samples ten times as far."""


def quantize_bundle(path: Path) -> Difference:
    """Put an eight-bit field and encoder in the place of a bundle's own.

    Returns the root mean square of how far its samples moved, in m.

    Raises:
        BundleError: there is no sound bundle at that path, which stays what it is.
        ExportError: the bundle has no field that flows over a cost map.
    """
    bundle = load_bundle(path)
    sampler, conditioning = bundle.manifest.sampler.kind, bundle.manifest.conditioning.kind
    if not isinstance(bundle.manifest.conditioning, CostMapEntry) or sampler != "ode":
        raise ExportError(
            f"int8: expected a bundle with a field over a cost map, got {sampler} on {conditioning}"
        )
    with into_place(path) as folder:
        shutil.copytree(path, folder, dirs_exist_ok=True)
        scenes = random_scenes(bundle, CALIBRATION, TRIAL_SHAPE, seed=1)
        asked = {"encode": _of_encode(bundle, scenes), "field": _of_field(bundle, scenes)}
        rounded = {role: _rounded(bundle, role, inputs, folder) for role, inputs in asked.items()}
        graphs = bundle.manifest.graphs | rounded
        manifest = bundle.manifest.model_copy(update={"graphs": graphs})
        (folder / FILE_NAME).write_bytes(manifest.to_json())
        return _moved(bundle, load_bundle(folder))


def _rounded(bundle: Bundle, role: str, inputs: Iterator[Arrays], folder: Path) -> GraphEntry:
    """Write a graph in eight bits, its scales of what it makes of the inputs."""
    entry, path = bundle.manifest.graphs[role], bundle.graph_path(role)
    with _quiet_quantizer():
        quantize_static(
            path,
            folder / entry.file,
            _Calibration(inputs),
            quant_format=QuantFormat.QDQ,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
            per_channel=True,
            # Seven bits of weight: where a processor lacks VNNI, sums of eight would saturate.
            reduce_range=True,
            nodes_to_quantize=_nodes_with_weights(path, *ROUNDED[role]),
            extra_options={"OpTypesToExcludeOutputQuantization": ["MatMul"]},
        )
    digest = hashlib.sha256((folder / entry.file).read_bytes()).hexdigest()
    return entry.model_copy(update={"sha256": digest, "precision": "int8"})


class _Calibration(CalibrationDataReader):
    def __init__(self, inputs: Iterator[Arrays]) -> None:
        self._inputs = inputs

    def get_next(self) -> Any:
        return next(self._inputs, None)


def _of_encode(bundle: Bundle, scenes: Sequence[MapScene]) -> Iterator[Arrays]:
    """What the encoder is asked on scenes."""
    names = bundle.manifest.graphs["encode"].input_names
    return (scene.inputs(names) for scene in scenes)


def _of_field(bundle: Bundle, scenes: Sequence[MapScene]) -> Iterator[Arrays]:
    """What the field is asked on scenes, at every time of the card's schedule."""
    flow, spec = OdeSampler(bundle, threads=1), bundle.card.sampler
    assert isinstance(spec, OdeSpec)
    modulate, field = open_graph(bundle, "modulate"), open_graph(bundle, "field")
    times = np.array(spec.schedule, np.float32)
    for seed, scene in enumerate(scenes):
        context = flow.encode(scene)
        modulation = modulate(**modulate.select({**context, "times": times}))["modulation"]
        noise = flow.draw_noise(context, num_samples=SAMPLE_TRIAL.N, seed=seed)
        begun = flow.beginning(context, noise)
        mean = {} if begun.mean is None else {PRIOR_MEAN: begun.mean[None]}
        for k, state in enumerate(flow.states(context, begun, spec)[:-1]):
            own = {"x_t": state[None], "modulation": modulation[:, k]}
            yield field.select({**context, **mean, **own})


def _nodes_with_weights(path: Path, kind: str, whole: int) -> list[str]:
    """Names of a graph's nodes of a kind whose second input is learnt, after the first `whole`."""
    graph = onnx.load(path).graph
    learnt = {tensor.name for tensor in graph.initializer}
    nodes = [node for node in graph.node if node.op_type == kind and node.input[1] in learnt]
    return [node.name for node in nodes[whole:]]


def _moved(bundle: Bundle, rounded: Bundle) -> Difference:
    """How far the card's samples lie from those of the bundle that was rounded."""
    whole, coarse = (OdeSampler(one, threads=1) for one in (bundle, rounded))
    D, spec = bundle.manifest.D, bundle.card.sampler
    assert isinstance(spec, OdeSpec)
    squares = []
    for seed, scene in enumerate(random_scenes(bundle, SCENES, TRIAL_SHAPE, seed=0)):
        contexts = [flow.encode(scene) for flow in (whole, coarse)]
        noise = whole.draw_noise(contexts[0], num_samples=SAMPLE_TRIAL.N, seed=seed)
        states = [
            flow.integrate(context, flow.beginning(context, noise), spec)
            for flow, context in zip((whole, coarse), contexts, strict=True)
        ]
        squares.append(((states[0] - states[1])[..., :D] ** 2).sum(-1).mean())
    return Difference("samples moved by, rms [m]", float(np.sqrt(np.mean(squares))))


@contextmanager
def _quiet_quantizer() -> Iterator[None]:
    """Without its advice to infer shapes first, which the graphs have; it asks the root logger."""
    logger = logging.getLogger()

    def is_no_advice(record: logging.LogRecord) -> bool:
        return "pre-processing" not in record.getMessage()

    logger.addFilter(is_no_advice)
    try:
        yield
    finally:
        logger.removeFilter(is_no_advice)
