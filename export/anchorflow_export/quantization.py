"""Quantize products of the field and convolutions of the encoder to eight bits: a third faster.

Weights are rounded once, a column at a time, activations by scales calibrated on random scenes. So
rounding does not depend on the other anchors of a call, as it would with scales of each call.
"""

from __future__ import annotations

import hashlib
import logging
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import numpy_helper
from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static

from anchorflow_client.contract import CostMapSpec, OdeSpec, resolve_for_card
from anchorflow_export.bundle import into_place
from anchorflow_export.parity import Difference
from anchorflow_export.planners.random_requests import map_request
from anchorflow_export.tracing import ExportError
from anchorflow_service.bundle import Bundle, load_bundle
from anchorflow_service.bundle.graphs import OnnxGraphs
from anchorflow_service.bundle.manifest import FILE_NAME, GraphEntry
from anchorflow_service.engine.conditioning.cost_map import CostMapConditioning, MapScene
from anchorflow_service.engine.interfaces import Arrays
from anchorflow_service.engine.samplers.flow import PRIOR_MEAN
from anchorflow_service.engine.samplers.ode import OdeSampler

SCENES = 4
CALIBRATION = 16  # scenes
CELLS = {"H": 64, "W": 48}  # of the random maps
ANCHORS = 9
NEARLY, MOST = 3.0, 64.5  # ratio of scales that are kept; numbers of a weight, in its scale
SUMMED = 1e-6
"""Largest difference that the order of a sum makes, over the largest of a tensor's numbers."""
ROUNDED = {"encode": ("Conv", 0), "field": ("MatMul", 1)}
"""Kind of node to quantize in each graph, and how many of them at its beginning to leave out: the
field's first product reads states, whose numbers vary most, and rounding it moves samples ten times
as far."""


def quantize_bundle(path: Path, *, like: Mapping[str, onnx.GraphProto] | None = None) -> Difference:
    """Replace a bundle's field and encoder by eight-bit ones.

    Returns the root mean square in m by which its samples moved.

    like: the `rounded_graphs` of a bundle from whose weights training went on: their scales are
        kept where those of this one differ little, and their other numbers where those differ by
        the rounding of sums alone, so that equal weights become equal graphs on every machine

    Raises `BundleError` if there is no sound bundle at that path, which stays what it is;
    `ExportError` if the bundle has no field that flows over a cost map.
    """
    bundle = load_bundle(path)
    sampler, conditioning = bundle.manifest.sampler.kind, bundle.manifest.conditioning.kind
    if not isinstance(bundle.manifest.conditioning, CostMapSpec) or sampler != "ode":
        raise ExportError(
            f"int8: expected a bundle with a field over a cost map, got {sampler} on {conditioning}"
        )
    with into_place(path) as folder:
        shutil.copytree(path, folder, dirs_exist_ok=True)
        scenes = random_scenes(bundle, CALIBRATION, seed=1)
        asked = {"encode": [*_of_encode(bundle, scenes)], "field": [*_of_field(bundle, scenes)]}
        rounded = {
            role: _rounded(bundle, role, inputs, folder, (like or {}).get(role))
            for role, inputs in asked.items()
        }
        graphs = bundle.manifest.graphs | rounded
        manifest = bundle.manifest.model_copy(update={"graphs": graphs})
        (folder / FILE_NAME).write_bytes(manifest.to_json())
        return _moved(bundle, load_bundle(folder))


def rounded_graphs(bundle: Bundle) -> dict[str, onnx.GraphProto]:
    """Return the graphs of a bundle that are in eight bits."""
    graphs = bundle.manifest.graphs.items()
    rounded = [role for role, entry in graphs if entry.precision == "int8"]
    return {role: onnx.load(bundle.graph_path(role)).graph for role in rounded}


def random_scenes(bundle: Bundle, count: int, *, seed: int) -> list[MapScene]:
    """Return scenes of random maps, as a request brings them."""
    request = map_request(bundle.card, {"B": count, **CELLS}, seed)
    scenes = CostMapConditioning(bundle.manifest).scenes(resolve_for_card(request, bundle.card))
    return list(scenes)


def _rounded(
    bundle: Bundle, role: str, inputs: Sequence[Arrays], folder: Path, like: onnx.GraphProto | None
) -> GraphEntry:
    """Write a graph in eight bits, with scales calibrated on the inputs or those of `like`."""
    entry, path = bundle.manifest.graphs[role], bundle.graph_path(role)
    _write_rounded(path, folder / entry.file, role, inputs, {})
    if like is not None:
        kept = _kept_scales(path, folder / entry.file, like)
        _write_rounded(path, folder / entry.file, role, inputs, kept)
        _keep_sums(folder / entry.file, like)
    digest = hashlib.sha256((folder / entry.file).read_bytes()).hexdigest()
    return entry.model_copy(update={"sha256": digest, "precision": "int8"})


def _write_rounded(
    path: Path, out: Path, role: str, inputs: Sequence[Arrays], scales: Mapping[str, Any]
) -> None:
    with _quiet_quantizer():
        quantize_static(
            path,
            out,
            _Calibration(iter(inputs)),
            quant_format=QuantFormat.QDQ,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
            per_channel=True,
            # Seven bits of weight: on a processor without VNNI, sums of eight would saturate.
            reduce_range=True,
            nodes_to_quantize=_nodes_with_weights(path, *ROUNDED[role]),
            extra_options={
                "OpTypesToExcludeOutputQuantization": ["MatMul"],
                "TensorQuantOverrides": dict(scales),
            },
        )


def _kept_scales(
    whole: Path, rounded: Path, like: onnx.GraphProto
) -> dict[str, list[dict[str, Any]]]:
    """Return the scales of `like` that are to be kept, as onnxruntime's quantizer takes them.

    One is kept if its ratio to that of `rounded`, which was made from `whole`, is below `NEARLY`;
    those of a weight's channels all or none, and only if no number is beyond its range.
    """
    weights, own = (_arrays(onnx.load(each).graph) for each in (whole, rounded))
    theirs, axes = _arrays(like), _axes(like)
    kept: dict[str, list[dict[str, Any]]] = {}
    for name, scale in theirs.items():
        tensor = name.removesuffix("_scale")
        is_bias = tensor.endswith("_quantized")  # the quantizer multiplies the scales it is used at
        if tensor == name or is_bias or name not in own or own[name].shape != scale.shape:
            continue
        if not (np.abs(np.log(own[name] / scale)) < np.log(NEARLY)).all():
            continue
        axis = {"axis": axes[f"{tensor}_quantized"]} if scale.ndim else {}
        if scale.ndim and _largest(weights[tensor], axis["axis"], scale) > MOST:
            continue
        zeros = np.atleast_1d(theirs[f"{tensor}_zero_point"])
        kept[tensor] = [
            {"scale": np.asarray(one), "zero_point": np.asarray(zero), **axis}
            for one, zero in zip(np.atleast_1d(scale), zeros, strict=True)
        ]
    return kept


def _keep_sums(path: Path, like: onnx.GraphProto) -> None:
    """Take from `like` the numbers that differ from those of a graph by `SUMMED` at most.

    Constants that the exporter sums up depend on the machine's order of summing.
    """
    model, theirs = onnx.load(path), _arrays(like)
    for tensor in model.graph.initializer:
        own, other = numpy_helper.to_array(tensor), theirs.get(tensor.name)
        if other is None or own.dtype != np.float32 or own.shape != other.shape or not own.size:
            continue
        if 0 < np.abs(own - other).max() <= SUMMED * np.abs(other).max():
            tensor.CopyFrom(numpy_helper.from_array(other, tensor.name))
    onnx.save(model, path)


def _largest(weight: NDArray[Any], axis: int, scale: NDArray[Any]) -> float:
    """Return the largest of a weight's numbers in units of the scales of its channels."""
    along = [-1 if k == axis % weight.ndim else 1 for k in range(weight.ndim)]
    return float(np.abs(weight / scale.reshape(along)).max())


def _axes(graph: onnx.GraphProto) -> dict[str, int]:
    """Return the axes of the channels of rounded weights, by their names."""
    nodes = (node for node in graph.node if node.op_type == "DequantizeLinear")
    return {
        node.input[0]: next((a.i for a in node.attribute if a.name == "axis"), 1) for node in nodes
    }


def _arrays(graph: onnx.GraphProto) -> dict[str, NDArray[Any]]:
    return {each.name: numpy_helper.to_array(each) for each in graph.initializer}


class _Calibration(CalibrationDataReader):
    def __init__(self, inputs: Iterator[Arrays]) -> None:
        self._inputs = inputs

    def get_next(self) -> Any:
        return next(self._inputs, None)


def _of_encode(bundle: Bundle, scenes: Sequence[MapScene]) -> Iterator[Arrays]:
    """Return the encoder's inputs for scenes."""
    names = bundle.manifest.graphs["encode"].input_names
    return (scene.inputs(names) for scene in scenes)


def _of_field(bundle: Bundle, scenes: Sequence[MapScene]) -> Iterator[dict[str, Any]]:
    """Yield the field's inputs for scenes, at every time of the card's schedule."""
    graphs, spec = OnnxGraphs(bundle), bundle.card.sampler
    flow = OdeSampler(bundle.manifest, graphs, threads=1)
    assert isinstance(spec, OdeSpec)
    times = np.array(spec.schedule, np.float32)
    for seed, scene in enumerate(scenes):
        context = flow.encode(scene)
        modulation = graphs.run("modulate", {**context, "times": times})["modulation"]
        noise = flow.draw_noise(context, num_samples=ANCHORS, seed=seed)
        begun = flow.beginning(context, noise)
        mean = {} if begun.mean is None else {PRIOR_MEAN: begun.mean[None]}
        for k, state in enumerate(flow.states(context, begun, spec)[:-1]):
            own = {"x_t": state[None], "modulation": modulation[:, k]}
            yield graphs.select("field", {**context, **mean, **own})


def _nodes_with_weights(path: Path, kind: str, whole: int) -> list[str]:
    """Return the nodes of a kind whose second input is a weight, after the first `whole`."""
    graph = onnx.load(path).graph
    learnt = {tensor.name for tensor in graph.initializer}
    nodes = [node for node in graph.node if node.op_type == kind and node.input[1] in learnt]
    return [node.name for node in nodes[whole:]]


def _moved(bundle: Bundle, rounded: Bundle) -> Difference:
    """Return the distance between the card's samples of a bundle and of its rounded copy."""
    whole, coarse = (
        OdeSampler(one.manifest, OnnxGraphs(one), threads=1) for one in (bundle, rounded)
    )
    D, spec = bundle.manifest.D, bundle.card.sampler
    assert isinstance(spec, OdeSpec)
    squares = []
    for seed, scene in enumerate(random_scenes(bundle, SCENES, seed=0)):
        contexts = [flow.encode(scene) for flow in (whole, coarse)]
        noise = whole.draw_noise(contexts[0], num_samples=ANCHORS, seed=seed)
        states = [
            flow.integrate(context, flow.beginning(context, noise), spec)
            for flow, context in zip((whole, coarse), contexts, strict=True)
        ]
        squares.append(((states[0] - states[1])[..., :D] ** 2).sum(-1).mean())
    return Difference("samples moved by, rms [m]", float(np.sqrt(np.mean(squares))))


@contextmanager
def _quiet_quantizer() -> Iterator[None]:
    """Silence the advice to infer shapes first, which the graphs have; it uses the root logger."""
    logger = logging.getLogger()

    def is_no_advice(record: logging.LogRecord) -> bool:
        return "pre-processing" not in record.getMessage()

    logger.addFilter(is_no_advice)
    try:
        yield
    finally:
        logger.removeFilter(is_no_advice)
