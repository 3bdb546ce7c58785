"""A planner of another kind comes through the same exporter: bytes in, a scored vocabulary out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from image_planner import HEIGHT, WIDTH, K, expected
from torch import Tensor, nn
from torch_camera_planner import BEV, CAMERA, GOALS, NAME, STATUS, CameraConfig, CameraPlanner

from anchorflow_client.contract import TensorSpec
from anchorflow_export.tracing import ExportError, random_tensor, trace
from anchorflow_service.bundle import load_bundle
from anchorflow_service.local import LocalClient

GREYS = (0, 100, 230)
STATES = np.array([[3.0, 0, 0, 0], [0.5, 0, 0, 0], [-7.25, 1, 0, 0]], np.float32)


def test_the_manifest_says_what_the_adapter_says(camera_bundle: Path) -> None:
    manifest = load_bundle(camera_bundle).manifest
    assert manifest.planner == NAME
    assert manifest.request.inputs == manifest.graphs["encode"].inputs == (CAMERA, STATUS)
    kinds = (manifest.conditioning.kind, manifest.sampler.kind, manifest.finish.kind)
    assert kinds == ("tensors", "vocabulary", "none")
    assert (manifest.time.steps, manifest.time.first_s, manifest.time.dt) == (8, 0.5, 0.5)
    assert manifest.answer.extras == (GOALS, BEV)
    shapes = {spec.name: spec.shape for spec in manifest.graphs["score"].outputs}
    assert shapes == {"trajectories": ("B", K, 8, 3), "scores": ("B", K), "goals": ("B", K, 2)}


def test_served_anchors_are_torchs(camera_bundle: Path) -> None:
    model = CameraPlanner(CameraConfig())
    pictures = np.stack([np.full((3, HEIGHT, WIDTH), grey, np.uint8) for grey in GREYS])
    answer = LocalClient.of(camera_bundle, threads=2).plan(
        inputs={"camera": pictures, "ego_status": STATES},
        num_samples=4,
        outputs=["goals", "bev_semantics"],
        seed=0,
    )
    with torch.inference_mode():
        context = model.encode(torch.from_numpy(pictures), torch.from_numpy(STATES))
        given = model.score(context["brightness"], context["speed"])
    semantics = context["bev_semantics"]
    np.testing.assert_allclose(answer.arrays["bev_semantics"], semantics, atol=1e-6)
    for b, grey in enumerate(GREYS):
        best = given["scores"][b].argsort(dim=-1, descending=True, stable=True)[:4]
        for name in ("trajectories", "scores", "goals"):
            got, wanted = answer.arrays[name][b], given[name][b, best]
            np.testing.assert_allclose(got, wanted, rtol=1e-5, atol=1e-5, err_msg=name)
        paths, scores = expected(grey / 255, STATES[b, 0])  # and both are what the hand works out
        np.testing.assert_allclose(answer.trajectories[b], paths[:4], atol=1e-5)
        np.testing.assert_allclose(answer.scores[b], scores[:4], atol=1e-4)


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
