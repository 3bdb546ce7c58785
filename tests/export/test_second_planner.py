"""A planner of another kind comes through the same exporter: bytes in, a scored vocabulary out."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from image_planner import HEIGHT, WIDTH, K, expected
from torch import Tensor, nn
from torch_camera_planner import (
    BEV,
    CAMERA,
    GOALS,
    NAME,
    STATUS,
    CameraConfig,
    CameraPlanner,
    camera_adapter,
)

from anchorflow_client.contract import AnchorBatch, TensorSpec
from anchorflow_export.adapter import ExportChoices
from anchorflow_export.bundle import BundleDescription, export_bundle
from anchorflow_export.quantization import quantize_bundle
from anchorflow_export.tracing import ExportError, random_tensor, trace
from anchorflow_service.bundle import load_bundle
from anchorflow_service.local import LocalClient

DESCRIPTION = BundleDescription(name="tiny-camera", version="1.0.0", planner=NAME)
GREYS = (0, 100, 230)
STATES = np.array([[3.0, 0, 0, 0], [0.5, 0, 0, 0], [-7.25, 1, 0, 0]], np.float32)
EXTRAS = ["goals", "bev_semantics"]


def planner() -> CameraPlanner:
    return CameraPlanner(CameraConfig())


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("camera") / "bundle"
    differences = export_bundle(camera_adapter(planner(), ExportChoices()), DESCRIPTION, out=out)
    assert {part.what.split()[0] for part in differences} == {"encode", "score", "sample"}
    assert max(part.error for part in differences) <= 1e-5
    return out


@pytest.fixture(scope="module")
def client(bundle: Path) -> LocalClient:
    return LocalClient.of(bundle, threads=2)


def pictures() -> np.ndarray:
    return np.stack([np.full((3, HEIGHT, WIDTH), grey, np.uint8) for grey in GREYS])


def asked(client: LocalClient, camera: np.ndarray, status: np.ndarray) -> AnchorBatch:
    inputs = {"camera": camera, "ego_status": status}
    return client.plan(inputs=inputs, num_samples=4, outputs=EXTRAS, seed=0)


def test_the_manifest_says_what_the_adapter_says(bundle: Path) -> None:
    manifest = load_bundle(bundle).manifest
    assert manifest.planner == NAME
    assert manifest.request.inputs == (CAMERA, STATUS)
    assert (manifest.conditioning.kind, manifest.sampler.kind, manifest.finish.kind) == (
        "tensors",
        "vocabulary",
        "none",
    )
    assert (manifest.time.steps, manifest.time.first_s, manifest.time.dt) == (8, 0.5, 0.5)
    assert manifest.answer.extras == (GOALS, BEV)
    assert manifest.graphs["encode"].inputs == (CAMERA, STATUS)
    shapes = {spec.name: spec.shape for spec in manifest.graphs["score"].outputs}
    assert shapes == {
        "trajectories": ("B", K, 8, 3),
        "scores": ("B", K),
        "goals": ("B", K, 2),
    }


def test_served_anchors_are_torchs(client: LocalClient) -> None:
    answer, model = asked(client, pictures(), STATES), planner()
    with torch.inference_mode():
        context = model.encode(torch.from_numpy(pictures()), torch.from_numpy(STATES))
        given = model.score(context["brightness"], context["speed"])
    for b, grey in enumerate(GREYS):
        best = given["scores"][b].argsort(dim=-1, descending=True, stable=True)[:4]
        for name in ("trajectories", "scores", "goals"):
            got, wanted = answer.arrays[name][b], given[name][b, best]
            np.testing.assert_allclose(got, wanted, rtol=1e-5, atol=1e-5, err_msg=name)
        np.testing.assert_allclose(
            answer.arrays["bev_semantics"][b], context["bev_semantics"][b], atol=1e-6
        )
        paths, scores = expected(grey / 255, STATES[b, 0])  # and both are what the hand works out
        np.testing.assert_allclose(answer.trajectories[b], paths[:4], atol=1e-5)
        np.testing.assert_allclose(answer.scores[b], scores[:4], atol=1e-4)


def test_a_drift_is_caught_in_the_graph_and_in_the_sample(tmp_path: Path) -> None:
    class Drifting(CameraPlanner):
        def score(self, brightness: Tensor, speed: Tensor) -> dict[str, Tensor]:
            drift = 0.01 if torch.compiler.is_exporting() else 0.0
            return super().score(brightness, speed + drift)

    adapter = camera_adapter(Drifting(CameraConfig()), ExportChoices())
    with pytest.raises(ExportError, match=r"score at B=1, trajectories: ") as caught:
        export_bundle(adapter, DESCRIPTION, out=tmp_path / "bundle")
    assert "sample of scene 2, trajectories: 4.00e-02" in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_a_bundle_that_the_service_refuses_replaces_none(bundle: Path, tmp_path: Path) -> None:
    out = tmp_path / "bundle"
    shutil.copytree(bundle, out)
    adapter = camera_adapter(planner(), ExportChoices())
    answer = replace(adapter.parts.answer, arrays=("scores", "clearance"))  # no graph gives it
    promising = replace(adapter, parts=replace(adapter.parts, answer=answer))
    with pytest.raises(ExportError, match=r"expected a bundle that can be served, got .*clearance"):
        export_bundle(promising, replace(DESCRIPTION, version="2.0.0"), out=out)
    assert load_bundle(out).card.version == DESCRIPTION.version
    assert list(tmp_path.iterdir()) == [out]


class Thresholded(nn.Module):
    """uint8 [B,Q] and int64 [Q] -> where it is bright, bytes and truth values [B,Q]."""

    def forward(self, image: Tensor, offset: Tensor) -> tuple[Tensor, Tensor]:
        shifted = image + offset.to(torch.uint8)
        return shifted, shifted > 100


def test_any_letter_is_an_open_axis_and_any_type_an_input() -> None:
    inputs = (
        TensorSpec("image", "uint8", ("B", "Q")),
        TensorSpec("offset", "int64", ("Q",), range=(0, 9)),
    )
    graph = trace(Thresholded(), inputs=inputs, outputs=("shifted", "bright"))
    assert graph.inputs == inputs
    assert graph.outputs == (
        TensorSpec("shifted", "uint8", ("B", "Q")),
        TensorSpec("bright", "bool", ("B", "Q")),
    )
    image, offset = (random_tensor(spec, {"Q": 4000}) for spec in inputs)
    assert (image.dtype, image.shape, offset.dtype) == (torch.uint8, (2, 4000), torch.int64)
    assert (image.min(), image.max()) == (0, 255)
    assert (offset.min(), offset.max()) == (0, 9)


def test_an_axis_that_is_computed_is_no_input() -> None:
    inputs = (TensorSpec("image", "uint8", ("B", "H//2")), TensorSpec("offset", "int64", ("B",)))
    with pytest.raises(ExportError, match=r"tensor image has shape \['B', 'H//2'\]: H//2 is neith"):
        trace(Thresholded(), inputs=inputs, outputs=("shifted", "bright"))


def test_a_bundle_without_a_field_is_not_rounded(bundle: Path) -> None:
    before = (bundle / "manifest.json").read_bytes()
    with pytest.raises(ExportError, match="with a field over a cost map, got vocabulary"):
        quantize_bundle(bundle)
    assert (bundle / "manifest.json").read_bytes() == before
