"""A planner of another kind comes through the same exporter: bytes in, a scored vocabulary out."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from image_planner import K
from torch import Tensor, nn
from torch_camera_planner import BEV, CAMERA, GOALS, NAME, STATUS

from anchorflow_client.contract import TensorSpec
from anchorflow_export.tracing import ExportError, random_tensor, trace
from anchorflow_service.bundle import load_bundle


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
