"""A bundle computes what torch computes, at sizes other than the trace's, or is not written."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import torch
from exported_bundles import export_once
from torch import Tensor
from torch_camera_planner import DESCRIPTION, CameraConfig, CameraPlanner, camera_adapter

from anchorflow_client.contract import EIGHT_STEP_SCHEDULE
from anchorflow_client.errors import InvalidRequest
from anchorflow_export.adapter import ExportChoices, PlannerAdapter
from anchorflow_export.bundle import export_bundle, record_quality
from anchorflow_export.planners.flowmp import flowmp_adapter
from anchorflow_export.tracing import ExportError
from anchorflow_models.flowmp import L2Config, L2SafetyCFM
from anchorflow_service.bundle import load_bundle
from anchorflow_service.bundle.entries import OdeEntry, PriorEntry
from anchorflow_service.local import LocalClient
from anchorflow_trajectory.motion import MotionLimits

CONFIG = L2Config(map_size=16, feature_channels=4, layers=1)


@pytest.fixture(scope="module")
def bundle() -> Path:
    return export_once("flowmp").path


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_the_folder_holds_three_graphs_and_a_manifest(bundle: Path) -> None:
    assert {*contents(bundle)} == {"encode.onnx", "field.onnx", "manifest.json", "modulate.onnx"}
    assert [path.name for path in bundle.parent.iterdir()] == ["bundle"]
    manifest = load_bundle(bundle).manifest
    field = {spec.name: spec.shape for spec in manifest.graphs["field"].inputs}
    assert field["x_t"] == field["prior_mean"] == ("B", "N", 24, 7)
    assert field["modulation"][0] == "B"
    # The encoder computes only what the other graphs take.
    taken = {name for role in ("modulate", "field") for name in manifest.graphs[role].input_names}
    assert {*manifest.graphs["encode"].output_names} <= {*taken, "prior_basis"}
    assert isinstance(manifest.sampler, OdeEntry)
    assert manifest.sampler.prior == PriorEntry(mean="route_states", basis="prior_basis")


def test_graphs_tell_nothing_of_the_machine_they_were_made_on(bundle: Path) -> None:
    for file in bundle.glob("*.onnx"):
        model = onnx.load(file)
        assert model.opset_import[0].version == 20
        assert b".py" not in model.SerializeToString()


def test_quality_is_recorded_afterwards(camera_bundle: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(camera_bundle, tmp_path / "bundle")
    record_quality(copy, {"any": 0.9})
    card = load_bundle(copy).card
    assert card.quality == {"any": 0.9}
    assert card.sha256 != load_bundle(camera_bundle).card.sha256


class Drifting(CameraPlanner):
    """Its graph gives other trajectories than torch."""

    def score(self, brightness: Tensor, speed: Tensor) -> dict[str, Tensor]:
        drift = 0.01 if torch.compiler.is_exporting() else 0.0
        return super().score(brightness, speed + drift)


class FixedSize(CameraPlanner):
    """Its graph takes no other batch than that of the trace."""

    def score(self, brightness: Tensor, speed: Tensor) -> dict[str, Tensor]:
        return super().score(brightness.reshape(2, 1), speed)


@pytest.mark.parametrize(
    ("planner", "words"),
    [
        (Drifting, r"score at B=1, trajectories: .*sample of scene 2, trajectories: 4\.00e-02"),
        (FixedSize, r"brightness came out as \[2, 1\], expected \['B', 1\]"),
    ],
)
def test_graphs_that_differ_from_torch_are_not_written(
    planner: type[CameraPlanner], words: str, tmp_path: Path
) -> None:
    adapter = camera_adapter(planner(CameraConfig()), ExportChoices())
    with pytest.raises(ExportError, match=words):
        export_bundle(adapter, DESCRIPTION, out=tmp_path / "bundle")
    assert list(tmp_path.iterdir()) == []


def test_a_bundle_is_replaced_and_anything_else_is_not(
    camera_bundle: Path, camera: PlannerAdapter, tmp_path: Path
) -> None:
    out = tmp_path / "bundle"
    out.mkdir()
    (out / "thesis.txt").write_text("years of work")
    with pytest.raises(ExportError, match="is there already and is not a bundle"):
        export_bundle(camera, DESCRIPTION, out=out)
    (out / "thesis.txt").rename(out / "manifest.json")
    training = {"checkpoint": "none"}
    export_bundle(camera, replace(DESCRIPTION, version="0.0.2", training=training), out=out)
    assert load_bundle(out).card.version == "0.0.2"
    assert load_bundle(out).manifest.training == training
    assert [path.name for path in tmp_path.iterdir()] == ["bundle"]
    for file in camera_bundle.glob("*.onnx"):  # the same weights give the same bytes
        assert (out / file.name).read_bytes() == file.read_bytes()


def test_what_cannot_be_replaced_is_refused_before_it_is_traced(
    camera_bundle: Path, camera: PlannerAdapter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = shutil.copytree(camera_bundle, tmp_path / "bundle")
    monkeypatch.setattr(PlannerAdapter, "trace", lambda _: pytest.fail("it was traced"))
    said = "expected a folder that can be replaced, got a mount point or the working directory"
    with monkeypatch.context() as inside:
        inside.chdir(out)
        for name in (".", "../bundle", out):
            with pytest.raises(ExportError, match=said):
                export_bundle(camera, DESCRIPTION, out=Path(name))
    with monkeypatch.context() as mounted:
        mounted.setattr(Path, "is_mount", lambda path: path == out)
        with pytest.raises(ExportError, match=said):
            export_bundle(camera, DESCRIPTION, out=out)
    for nowhere in ("/proc/absent/bundle", out / "manifest.json" / "bundle"):
        with pytest.raises(ExportError, match=f"{nowhere}: expected a place to write a bundle"):
            export_bundle(camera, DESCRIPTION, out=Path(nowhere))
    assert contents(out) == contents(camera_bundle)


def test_a_bundle_that_the_service_refuses_replaces_none(
    camera_bundle: Path, camera: PlannerAdapter, tmp_path: Path
) -> None:
    out = shutil.copytree(camera_bundle, tmp_path / "bundle")
    answer = replace(camera.parts.answer, arrays=("scores", "clearance"))  # no graph gives it
    promising = replace(camera, parts=replace(camera.parts, answer=answer))
    with pytest.raises(ExportError, match=r"expected a bundle that can be served, got .*clearance"):
        export_bundle(promising, replace(DESCRIPTION, version="2.0.0"), out=out)
    assert contents(out) == contents(camera_bundle)
    assert list(tmp_path.iterdir()) == [out]


@pytest.mark.parametrize("name", ["a b/c", "flow*", "größe", ""])
def test_a_name_that_no_key_can_hold_is_refused(
    name: str, camera: PlannerAdapter, tmp_path: Path
) -> None:
    with pytest.raises(ExportError, match=r"name: .*expected a name without spaces"):
        export_bundle(camera, replace(DESCRIPTION, name=name), out=tmp_path / "bundle")
    assert list(tmp_path.iterdir()) == []


def test_an_open_horizon_needs_its_range(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is refused at once, not after a minute of tracing."""
    adapter = flowmp_adapter(L2SafetyCFM(CONFIG), ExportChoices(ranges={}))
    monkeypatch.setattr(PlannerAdapter, "trace", lambda _: pytest.fail("it was traced"))
    with pytest.raises(ExportError, match=r"ranges\.horizon_s"):
        export_bundle(adapter, DESCRIPTION, out=tmp_path / "bundle")
    assert list(tmp_path.iterdir()) == []


def test_what_is_chosen_at_export_is_what_requests_may_ask(bundle: Path) -> None:
    """A limit without a range cannot be set, one with a range only within it."""
    card = load_bundle(bundle).card
    assert card.time.dt is None  # each anchor has its own
    limits = card.cost_map.limits
    assert (limits.v_max, limits.a_max, limits.robot_radius) == (1.5, 2.5, 0.3)
    assert limits.horizon_s is None
    assert card.cost_map.ranges["v_max"] == (0.2, 4.0)
    assert card.ode.schedule == EIGHT_STEP_SCHEDULE
    client = LocalClient.of(bundle, threads=1)
    request: dict[str, Any] = {
        "cost_map": {"data": np.zeros((1, 40, 40)), "resolution": 0.25},
        "x_curr": [-3.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        "x_goal": [3.0, 0.0, 0.0, 0.0],
        "num_samples": 4,
        "seed": 1,
    }
    own, slow = client.plan(**request), client.plan(**request, v_max=0.5)
    assert own.is_finite
    assert np.ptp(own.durations) > 0
    assert slow.durations.min() > own.durations.max()
    np.testing.assert_allclose(client.plan(**request, horizon_s=9.0).durations, 9.0)
    for name, value in (("v_max", 5.0), ("robot_radius", 0.4), ("horizon_s", 0.5)):
        wrong: dict[str, Any] = {**request, name: value}
        with pytest.raises(InvalidRequest, match=name):
            client.plan(**wrong)


def test_noise_and_horizon_are_the_bundles_own() -> None:
    model = L2SafetyCFM(CONFIG)
    before = model.prior.factor.clone()
    choices = ExportChoices(noise_scale=1.4, limits=MotionLimits(2.0, 3.0, horizon_s=8.0))
    for _ in range(2):
        adapter = flowmp_adapter(model, choices)
        factor = adapter.roles["encode"].model.prior.factor
        torch.testing.assert_close(factor, 1.4 * before)
        # All anchors last as long as the card says.
        assert adapter.parts.time.dt == pytest.approx(8.0 / (CONFIG.num_steps - 1))
    torch.testing.assert_close(model.prior.factor, before)
