"""A bundle in eight bits: integer products inside, nearly the same anchors outside."""

from __future__ import annotations

import logging
import shutil
from pathlib import Path

import numpy as np
import onnx
import pytest
from exported_bundles import export_once
from onnx import numpy_helper

from anchorflow_client.contract import OdeSpec
from anchorflow_export.planners import check_used
from anchorflow_export.quantization import quantize_bundle, random_scenes, rounded_graphs
from anchorflow_export.tracing import ExportError
from anchorflow_service.bundle import DEFAULT_BUNDLE, Bundle, BundleError, load_bundle
from anchorflow_service.bundle.graphs import OnnxGraphs
from anchorflow_service.engine.samplers.ode import OdeSampler

FLOAT = onnx.TensorProto.FLOAT


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    """One to round, or to break."""
    return shutil.copytree(export_once("flowmp").path, tmp_path / "bundle")


def sampler_of(bundle: Bundle) -> OdeSampler:
    return OdeSampler(bundle.manifest, OnnxGraphs(bundle), threads=1)


def operations(bundle: Path, role: str) -> set[str]:
    path = load_bundle(bundle).graph_path(role)
    return {node.op_type for node in onnx.load(path).graph.node}


def test_field_and_encoder_are_rounded(bundle: Path, flowmp_rounded: Path) -> None:
    before = load_bundle(bundle).manifest
    manifest = load_bundle(flowmp_rounded).manifest  # its hashes and signatures hold
    for role in ("encode", "field"):
        assert "QuantizeLinear" in operations(flowmp_rounded, role)
        assert manifest.graphs[role].precision == "int8"
    assert manifest.graphs["modulate"] == before.graphs["modulate"]
    assert [path.name for path in flowmp_rounded.parent.iterdir()] == ["bundle"]


def test_numbers_of_a_bundle_like_it_are_kept_where_they_nearly_fit(
    bundle: Path, flowmp_rounded: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Scales, and sums of the encoder: equal weights become equal graphs on every machine."""
    graphs = rounded_graphs(load_bundle(flowmp_rounded))
    held = {each.name: each for each in graphs["field"].initializer}
    scales = [n for n in held if n.endswith("_scale") and not n.endswith("_quantized_scale")]
    activations = [name for name in scales if not held[name].dims]
    weight = next(name for name in scales if held[name].dims)
    wanted = {activations[0]: 1.5, activations[1]: 4.0, weight: 1.2}
    given = {name: numpy_helper.to_array(held[name]).copy() for name in wanted}
    for name, factor in wanted.items():
        held[name].CopyFrom(numpy_helper.from_array(given[name] * np.float32(factor), name))
    floats = [each for each in graphs["encode"].initializer if each.data_type == FLOAT]
    summed, learnt = sorted(floats, key=lambda each: -np.prod(each.dims, initial=1))[:2]
    for tensor, factor in ((summed, 1 + 4e-7), (learnt, 1 + 1e-4)):
        values = numpy_helper.to_array(tensor) * np.float32(factor)
        tensor.CopyFrom(numpy_helper.from_array(values, tensor.name))

    with caplog.at_level(logging.WARNING):
        quantize_bundle(bundle, like=graphs)

    assert caplog.records == []
    found = rounded_graphs(load_bundle(bundle))
    got = {e.name: numpy_helper.to_array(e) for role in found.values() for e in role.initializer}
    for name, kept in ((activations[0], 1.5), (activations[1], 1.0), (weight, 1.2)):
        np.testing.assert_allclose(got[name], given[name] * kept, rtol=1e-6)
    np.testing.assert_array_equal(got[summed.name], numpy_helper.to_array(summed))
    assert not np.array_equal(got[learnt.name], numpy_helper.to_array(learnt))


def test_rounding_is_fine_and_anchors_do_not_depend_on_their_neighbours(
    bundle: Path, flowmp_rounded: Path
) -> None:
    whole = sampler_of(load_bundle(bundle))
    rounded = load_bundle(flowmp_rounded)
    flow, spec = sampler_of(rounded), rounded.card.sampler
    assert isinstance(spec, OdeSpec)
    (scene,) = random_scenes(rounded, 1, seed=1)
    context = flow.encode(scene)
    for name, array in whole.encode(scene).items():
        size, off = np.abs(array).max(), context[name] - array
        assert np.sqrt(np.square(off).mean()) <= 0.01 * size, name
        np.testing.assert_allclose(context[name], array, atol=0.08 * size)
    noise = flow.draw_noise(context, num_samples=24, seed=0)
    begun = flow.beginning(context, noise)
    many = flow.integrate(context, begun, spec)
    wanted = whole.integrate(context, begun, spec)
    carried = np.abs(wanted - begun.x).max()
    np.testing.assert_allclose(many, wanted, atol=0.05 * carried)
    few = flow.integrate(context, flow.beginning(context, noise[:8]), spec)
    np.testing.assert_array_equal(many[:8], few)


def test_a_broken_bundle_stays_as_it_is(bundle: Path) -> None:
    field = bundle / "field.onnx"
    field.write_bytes(field.read_bytes()[:-1])
    before = {path.name: path.read_bytes() for path in bundle.iterdir()}
    with pytest.raises(BundleError, match=r"field\.onnx"):
        quantize_bundle(bundle)
    assert {path.name: path.read_bytes() for path in bundle.iterdir()} == before


def test_a_bundle_without_a_cost_map_is_refused(camera_bundle: Path, tmp_path: Path) -> None:
    goalflow = shutil.copytree(DEFAULT_BUNDLE.parent / "goalflow", tmp_path / "goalflow")
    before = (camera_bundle / "manifest.json").read_bytes()
    for folder, sampler in ((goalflow, "ode"), (camera_bundle, "vocabulary")):
        with pytest.raises(ExportError, match=f"with a field over a cost map, got {sampler}"):
            quantize_bundle(folder)
    assert (camera_bundle / "manifest.json").read_bytes() == before


def test_a_planner_without_a_cost_map_has_no_use_for_eight_bits() -> None:
    check_used("flowmp", ["int8"])
    with pytest.raises(ExportError, match=r"goalflow has a use for .* got int8"):
        check_used("goalflow", ["int8"])
