"""Graphs that cannot be wired together by name are found before they are opened."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from anchorflow_service.bundle import BundleError, load_bundle
from anchorflow_service.engine import Engine

Edit = Callable[..., None]


def refusal(folder: Path) -> str:
    """The words with which an engine refuses a bundle that the reader takes."""
    bundle = load_bundle(folder)
    with pytest.raises(BundleError) as caught:
        Engine(bundle, threads=1)
    assert caught.value.file == folder / "manifest.json"
    return str(caught.value)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (("sampler", "prior", "basis"), "bases", "sampler.prior: 'bases' is not one of"),
        (("graphs",), {}, "a bundle of kind ode needs the role encode, field, modulate"),
        (("graphs", "field", "inputs", 1, "name"), "mean", "graphs.field.inputs: 'mean' is not"),
        (("sampler", "prior"), None, "graphs.field.inputs: 'prior_mean' is not one of"),
        (("sampler", "prior", "mean"), "means", "graphs.field.inputs: 'prior_mean' is not one of"),
        (
            ("sampler", "prior", "mean"),
            "middle",
            "'middle' is not one of prior_basis",
        ),
        (("graphs", "field", "outputs", 0, "name"), "dx", "outputs: expected dx_t, got dx"),
        (
            ("graphs", "field", "inputs", 0, "shape"),
            ["B", "N", 9, 7],
            "x_t has [9, 7] for [T,S], expected 8 and at least 7 numbers",
        ),
        (
            ("graphs", "field", "inputs", 0, "shape"),
            ["B", "N", 8, 6],
            "x_t has [8, 6] for [T,S], expected 8 and at least 7 numbers",
        ),
        (
            ("graphs", "field", "inputs", 0, "shape"),
            ["B", "N", 8, "S"],
            "x_t has [8, 'S'] for [T,S]",
        ),
        (("graphs", "encode", "inputs", 0, "name"), "camera", "graphs.encode.inputs: 'camera' is"),
    ],
)
def test_a_flow_that_cannot_be_wired(
    tiny_bundle: Path, edit_manifest: Edit, path: tuple, value: object, message: str
) -> None:
    edit_manifest(*path, to=value)

    assert message in refusal(tiny_bundle)


def test_a_missing_role_is_named(tiny_bundle: Path, edit_manifest: Edit) -> None:
    graphs = load_bundle(tiny_bundle).manifest.model_dump(mode="json")["graphs"]
    del graphs["modulate"]
    edit_manifest("graphs", to=graphs)

    assert "needs the role modulate" in refusal(tiny_bundle)
