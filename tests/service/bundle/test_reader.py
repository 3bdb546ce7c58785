"""A broken bundle is refused before it serves, and the error names the file and the fault."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from anchorflow_service.bundle import BundleError, load_bundle
from anchorflow_service.bundle.graphs import open_graph
from anchorflow_service.bundle.manifest import parse_manifest

Edit = Callable[..., None]


def test_a_sound_bundle_gives_its_card(tiny_bundle: Path) -> None:
    bundle = load_bundle(tiny_bundle)
    card = bundle.card
    assert (card.name, card.version, card.planner) == ("tiny", "1.2.3", "by-hand")
    assert card.sha256 == hashlib.sha256((tiny_bundle / "manifest.json").read_bytes()).hexdigest()
    assert card.ode.schedule == (0.0, 0.5, 1.0)
    assert [spec.name for spec in card.inputs] == ["cost_map", "x_curr"]
    assert card.inputs[0].shape == ("B", "C", "H", "W")
    assert (card.T, card.D, card.time.dt, card.cost_map.limits.robot_radius) == (8, 2, 1.0, 0.25)


def test_the_written_manifest_reads_back(tiny_bundle: Path) -> None:
    manifest = load_bundle(tiny_bundle).manifest
    (tiny_bundle / "manifest.json").write_bytes(manifest.to_json())
    assert load_bundle(tiny_bundle).manifest == manifest


def test_anchors_may_have_their_own_durations(free_bundle: Path) -> None:
    bundle = load_bundle(free_bundle)

    assert (bundle.card.time.dt, bundle.card.cost_map.limits.horizon_s) == (None, None)
    assert bundle.card.cost_map.ranges["horizon_s"] == (1.0, 120.0)
    assert parse_manifest(bundle.manifest.to_json()) == bundle.manifest


def test_one_time_step_beside_own_durations_is_refused(
    free_bundle: Path, edit_manifest: Edit
) -> None:
    edit_manifest("time.dt", to=1.0)

    words = r"time\.dt is 1\.0, expected null beside limits\.horizon_s null"
    with pytest.raises(BundleError, match=words):
        load_bundle(free_bundle)


def test_a_changed_graph_is_refused_by_its_hash(tiny_bundle: Path) -> None:
    with (tiny_bundle / "field.onnx").open("ab") as file:
        file.write(b"\0")
    with pytest.raises(BundleError, match=r"field\.onnx: its sha256 is \w+, the manifest says"):
        load_bundle(tiny_bundle)


@pytest.mark.parametrize("name", ["field.onnx", "manifest.json"])
def test_a_missing_file_is_named(tiny_bundle: Path, name: str) -> None:
    (tiny_bundle / name).unlink()
    with pytest.raises(BundleError, match="No such file") as caught:
        load_bundle(tiny_bundle)
    assert caught.value.file == tiny_bundle / name


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir])
@pytest.mark.parametrize("name", ["field.onnx", "manifest.json"])
@pytest.mark.timeout(60)
def test_what_is_no_file_is_named(tiny_bundle: Path, name: str, make: Edit) -> None:
    """Reading a pipe would block until a writer comes."""
    (tiny_bundle / name).unlink()
    make(tiny_bundle / name)
    with pytest.raises(BundleError, match=r"cannot be read: not a regular file$") as caught:
        load_bundle(tiny_bundle)
    assert caught.value.file == tiny_bundle / name


def test_a_truncated_manifest(tiny_bundle: Path) -> None:
    file = tiny_bundle / "manifest.json"
    file.write_bytes(file.read_bytes()[:100])
    with pytest.raises(BundleError, match=r"manifest\.json: Invalid JSON"):
        load_bundle(tiny_bundle)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("format", 1, "format: expected 2, got 1: export its checkpoint anew with"),
        ("time.steps", "8", r"time\.steps: Input should be a valid integer"),
        ("time.dt", 0.5, r"time\.dt is 0\.5, expected horizon_s / \(steps - 1\) = 1\.0"),
        ("time.first_s", 0.5, r"time\.first_s is 0\.5, expected 0 beside a cost map"),
        ("conditioning.limits.horizon_s", None, r"ranges\.horizon_s is missing, expected least"),
        ("time.dt", None, r"time\.dt is null, expected 1\.0 s"),
        (
            "conditioning.ranges",
            {"robot_radius": [0.6, 0.1]},
            r"ranges\.robot_radius is \[0\.6, 0\.1\], expected least and greatest in \[0, 5\] m",
        ),
        (
            "conditioning.ranges",
            {"v_max": [0.1, 200]},
            r"ranges\.v_max is \[0\.1, 200\], expected least and greatest in \(0, 100\] m/s",
        ),
        (
            "conditioning.ranges",
            {"v_max": [0.1, 1.5]},
            r"ranges\.v_max is .*, without limits\.v_max = 2",
        ),
        ("conditioning.ranges", {"mass": [1, 2]}, r"ranges\.mass\.\[key\]: Input should be"),
        (
            "answer.extras",
            [{"name": "dt", "dtype": "float32", "shape": ["B", "N"]}],
            r"answer\.extras: 'dt' is a name that every answer has",
        ),
        ("conditioning.kind", "words", "conditioning: Input tag 'words' found using 'kind'"),
        ("answer.arrays", ["speeds"], "answer.arrays: 'speeds' is none of velocities"),
        ("request.inputs.1.shape", [6], r"x_curr has shape \[6\], expected B first"),
        (
            "request.inputs.1.name",
            "x.curr",
            r"request\.inputs: x\.curr has a dot, which the binary",
        ),
        ("surprise", 1, "surprise: Extra inputs are not permitted"),
        ("graphs.field.file", "../field.onnx", r"graphs\.field\.file"),
        ("sampler.method", "rk45", "unknown method 'rk45'"),
        ("sampler.schedule", [0.0, 0.9], "strictly rising to 1"),
    ],
)
def test_a_wrong_manifest_names_the_field(
    tiny_bundle: Path, edit_manifest: Edit, path: str, value: object, message: str
) -> None:
    edit_manifest(path, to=value)
    with pytest.raises(BundleError, match=message) as caught:
        load_bundle(tiny_bundle)
    assert caught.value.file.name == "manifest.json"


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("inputs.0.shape", ["B", "N", 9, 7], r"x_t has shape \['B', 'N', 8, 7\]"),
        ("inputs.0.shape", ["B", "N", "T", 7], "x_t has shape"),
        ("inputs.0.shape", [1, "N", 8, 7], "x_t has shape"),
        ("inputs.0.dtype", "int64", r"x_t is tensor\(float\), the manifest says int64"),
        ("outputs.0.shape", ["B", "N", 56], "output dx_t has shape"),
    ],
)
def test_a_graph_that_is_not_what_the_manifest_says(
    tiny_bundle: Path, edit_manifest: Edit, path: str, value: object, message: str
) -> None:
    edit_manifest(f"graphs.field.{path}", to=value)
    with pytest.raises(BundleError, match=message) as caught:
        open_graph(load_bundle(tiny_bundle), "field")
    assert caught.value.file.name == "field.onnx"


def test_a_graph_of_other_inputs_is_refused(tiny_bundle: Path, edit_manifest: Edit) -> None:
    shutil.copy(tiny_bundle / "modulate.onnx", tiny_bundle / "field.onnx")
    digest = hashlib.sha256((tiny_bundle / "field.onnx").read_bytes()).hexdigest()
    edit_manifest("graphs.field.sha256", to=digest)
    with pytest.raises(BundleError, match="its inputs are times, means, the manifest says x_t"):
        open_graph(load_bundle(tiny_bundle), "field")


def test_bytes_that_are_no_graph_are_refused(tiny_bundle: Path, edit_manifest: Edit) -> None:
    (tiny_bundle / "field.onnx").write_bytes(b"not a graph")
    digest = hashlib.sha256(b"not a graph").hexdigest()
    edit_manifest("graphs.field.sha256", to=digest)
    with pytest.raises(BundleError, match=r"field\.onnx: onnxruntime cannot open it"):
        open_graph(load_bundle(tiny_bundle), "field")
