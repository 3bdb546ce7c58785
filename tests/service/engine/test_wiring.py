"""Graphs that cannot be wired together by name are found before they are opened."""

from __future__ import annotations

from pathlib import Path

import pytest
from diffusion_planner import write_diffusion_bundle
from written_graphs import set_in_manifest

from anchorflow_service.bundle import BundleError, load_bundle
from anchorflow_service.engine import Engine

DELETED = ...


def assert_refused(folder: Path, message: str) -> None:
    with pytest.raises(BundleError) as caught:
        Engine(load_bundle(folder), threads=1)
    assert caught.value.file == folder / "manifest.json"
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("sampler.prior.basis", "bases", "sampler.prior: 'bases' is not one of"),
        ("graphs.modulate", DELETED, "needs the role modulate"),
        ("graphs", {}, "a bundle of kind ode needs the role encode, field, modulate"),
        ("graphs.field.inputs.1.name", "mean", "graphs.field.inputs: 'mean' is not"),
        ("sampler.prior", None, "graphs.field.inputs: 'prior_mean' is not one of"),
        ("sampler.prior.mean", "means", "graphs.field.inputs: 'prior_mean' is not one of"),
        ("sampler.prior.mean", "middle", "'middle' is not one of prior_basis"),
        ("graphs.field.outputs.0.name", "dx", "outputs: expected dx_t, got dx"),
        ("graphs.field.inputs.0.shape", ["B", "N", 9, 7], "x_t has [9, 7] for [T,S], expected 8"),
        (
            "graphs.field.inputs.0.shape",
            ["B", "N", 8, 6],
            "x_t has [8, 6] for [T,S], expected 8 and at least 7 numbers",
        ),
        ("graphs.field.inputs.0.shape", ["B", "N", 8, "S"], "x_t has [8, 'S'] for [T,S]"),
        ("graphs.encode.inputs.0.name", "camera", "graphs.encode.inputs: 'camera' is"),
        ("conditioning.channels", 5, "channels: expected 3, obstacles, traversability and risk"),
    ],
)
def test_a_flow_that_cannot_be_wired(
    tiny_bundle: Path, path: str, value: object, message: str
) -> None:
    set_in_manifest(tiny_bundle, path, to=value)
    load_bundle(tiny_bundle)  # which the reader takes
    assert_refused(tiny_bundle, message)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("sampler.keep", 25, "keep: expected at most 24, got 25"),
        ("sampler.steps", 3, "steps: expected one of 1, 2, 4, each once, got 3"),
        ("sampler.start", 1000, "start: expected a level below 1000, got 1000"),
        (
            "sampler.schedules",
            [[0, 10]],
            "schedules: expected falling times from 999 to 0, got [0, 10]",
        ),
        (
            "sampler.noise",
            {"levels": 9, "first": 0.3, "last": 0.2},
            "expected 0 < first <= last < 1",
        ),
        ("sampler.anchors", 4, "anchors is ['B', 3, 8, 2], expected ['B', 4, 8, 2]"),
        ("sampler.groups", 0, "groups"),
        ("graphs.coarse", DELETED, "needs the role coarse"),
        ("graphs.fine.outputs.0.name", "fast", "fine.outputs: 'scores' is not one of"),
        ("graphs.denoise.inputs.2.name", "fast", "denoise.inputs: 'fast' is not one"),
        ("graphs.coarse.outputs.1.name", "fast", "fine.inputs: 'features' is not one"),
    ],
)
def test_a_diffusion_that_cannot_be_wired(
    tmp_path: Path, path: str, value: object, message: str
) -> None:
    set_in_manifest(write_diffusion_bundle(tmp_path), path, to=value)
    assert_refused(tmp_path, message)
