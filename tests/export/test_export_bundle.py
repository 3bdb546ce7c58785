"""A bundle computes what torch computes, at sizes other than the trace's, or is not written."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import wraps
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import torch
from torch import Tensor

from anchorflow_client.contract import EIGHT_STEP_SCHEDULE, AnchorRequest
from anchorflow_client.errors import InvalidRequest
from anchorflow_export.adapter import ExportChoices
from anchorflow_export.bundle import BundleDescription, export_bundle, record_quality
from anchorflow_export.planners.flowmp import flowmp_adapter
from anchorflow_export.tracing import ExportError
from anchorflow_models.flowmp import L2Config, L2SafetyCFM
from anchorflow_service.bundle import load_bundle
from anchorflow_service.bundle.manifest import OdeEntry, PriorEntry
from anchorflow_service.local import LocalClient


@pytest.fixture
def bundle(small_bundle: Path) -> Path:
    return small_bundle


def test_the_folder_holds_three_graphs_and_a_manifest(bundle: Path) -> None:
    names = sorted(path.name for path in bundle.iterdir())
    assert names == ["encode.onnx", "field.onnx", "manifest.json", "modulate.onnx"]
    assert [path.name for path in bundle.parent.iterdir()] == ["bundle"]
    manifest = load_bundle(bundle).manifest
    field = {spec.name: spec.shape for spec in manifest.graphs["field"].inputs}
    assert field["x_t"] == field["prior_mean"] == ("B", "N", 8, 7)
    assert field["modulation"] == ("B", 32)
    assert field["features"] == ("B", 4, 12, 12)
    assert "unused" not in manifest.graphs["encode"].output_names
    assert manifest.training == {"checkpoint": "none"}
    assert isinstance(manifest.sampler, OdeEntry)
    assert manifest.sampler.prior == PriorEntry(mean="route_states", basis="prior_basis")
    assert manifest.time.dt == pytest.approx(8.0 / 7)  # all last as long as the card says


def test_graphs_tell_nothing_of_the_machine_they_were_made_on(bundle: Path) -> None:
    for file in bundle.glob("*.onnx"):
        model = onnx.load(file)
        assert model.opset_import[0].version == 20
        assert b".py" not in model.SerializeToString()


def test_the_engine_plans_with_it(bundle: Path) -> None:
    batch = LocalClient.of(bundle, threads=2).plan_request(
        AnchorRequest.build(
            cost_map={"data": np.zeros((2, 1, 40, 40)), "resolution": 0.25},
            x_curr=[-3.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            x_goal=[3.0, 0.0, 0.0, 0.0],
            num_samples=9,
            seed=1,
        )
    )
    assert batch.trajectories.shape == (2, 9, 8, 2)
    assert batch.is_finite
    assert batch.trajectories[0].tobytes() == batch.trajectories[1].tobytes()


def test_quality_is_recorded_afterwards(bundle: Path, tmp_path: Path) -> None:
    copy = tmp_path / "bundle"
    copy.mkdir()
    for file in bundle.iterdir():
        (copy / file.name).write_bytes(file.read_bytes())
    record_quality(copy, {"any": 0.9})
    card = load_bundle(copy).card
    assert card.quality == {"any": 0.9}
    assert card.sha256 != load_bundle(bundle).card.sha256


def test_graphs_that_differ_from_torch_are_not_written(
    small_flow: Any, adapted: Any, description: BundleDescription, tmp_path: Path
) -> None:
    model = small_flow()
    exact = model.field

    @wraps(exact)
    def drifting(*inputs: Any, **named: Any) -> Tensor:
        return exact(*inputs, **named) + (0.01 if torch.compiler.is_exporting() else 0.0)

    model.field = drifting
    with pytest.raises(ExportError, match=r"field at .*, dx_t: \d\.\d\de-0[23]") as caught:
        export_bundle(adapted(model), description, out=tmp_path / "bundle")
    assert "sample of scene 0" in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_a_graph_that_holds_for_one_size_only_is_not_written(
    small_flow: Any, adapted: Any, description: BundleDescription, tmp_path: Path
) -> None:
    model = small_flow()
    exact = model.modulate
    model.modulate = lambda times, context: exact(times.reshape(5), context)
    with pytest.raises(ExportError, match=r"times came out as \[5\], expected \['K'\]"):
        export_bundle(adapted(model), description, out=tmp_path / "bundle")
    assert list(tmp_path.iterdir()) == []


def test_a_bundle_is_replaced_and_anything_else_is_not(
    bundle: Path, small_flow: Any, adapted: Any, description: BundleDescription, tmp_path: Path
) -> None:
    out = tmp_path / "bundle"
    out.mkdir()
    (out / "thesis.txt").write_text("years of work")
    with pytest.raises(ExportError, match="is there already and is not a bundle"):
        export_bundle(adapted(small_flow()), description, out=out)
    (out / "thesis.txt").rename(out / "manifest.json")
    export_bundle(adapted(small_flow()), replace(description, version="0.0.2"), out=out)
    assert load_bundle(out).card.version == "0.0.2"
    assert [path.name for path in tmp_path.iterdir()] == ["bundle"]
    for file in bundle.glob("*.onnx"):  # the same weights give the same bytes
        assert (out / file.name).read_bytes() == file.read_bytes()


def test_what_cannot_be_replaced_is_refused_before_it_is_traced(
    bundle: Path,
    small_flow: Any,
    adapted: Any,
    description: BundleDescription,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    adapter, out = adapted(small_flow()), tmp_path / "bundle"
    shutil.copytree(bundle, out)
    monkeypatch.setattr(type(adapter), "trace", lambda _: pytest.fail("it was traced"))
    said = "expected a folder that can be replaced, got a mount point or the working directory"
    with monkeypatch.context() as inside:
        inside.chdir(out)
        for name in (".", "../bundle", out):
            with pytest.raises(ExportError, match=said):
                export_bundle(adapter, description, out=Path(name))
    with monkeypatch.context() as mounted:
        mounted.setattr(Path, "is_mount", lambda path: path == out)
        with pytest.raises(ExportError, match=said):
            export_bundle(adapter, description, out=out)
    for nowhere in ("/proc/absent/bundle", out / "manifest.json" / "bundle"):
        with pytest.raises(ExportError, match=f"{nowhere}: expected a place to write a bundle"):
            export_bundle(adapter, description, out=Path(nowhere))
    assert {path.name: path.read_bytes() for path in out.iterdir()} == {
        path.name: path.read_bytes() for path in bundle.iterdir()
    }


def test_what_is_chosen_at_export_is_what_requests_may_ask(exported: Callable[[str], Any]) -> None:
    """A limit without a range cannot be set, one with a range only within it."""
    made = exported("flowmp")
    card = load_bundle(made.path).card
    assert card.time.dt is None  # each anchor has its own
    limits = card.cost_map.limits
    assert (limits.v_max, limits.a_max, limits.robot_radius) == (1.5, 2.5, 0.3)
    assert limits.horizon_s is None
    assert card.cost_map.ranges["v_max"] == (0.2, 4.0)
    assert card.ode.schedule == EIGHT_STEP_SCHEDULE
    client = LocalClient.of(made.path, threads=1)
    request: dict[str, Any] = {
        "cost_map": {"data": np.zeros((1, 40, 40)), "resolution": 0.25},
        "x_curr": [-3.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        "x_goal": [3.0, 0.0, 0.0, 0.0],
        "num_samples": 4,
        "seed": 1,
    }
    own, slow = client.plan(**request), client.plan(**request, v_max=0.5)
    assert np.ptp(own.durations) > 0
    assert slow.durations.min() > own.durations.max()
    np.testing.assert_allclose(client.plan(**request, horizon_s=9.0).durations, 9.0)
    for name, value in (("v_max", 5.0), ("robot_radius", 0.4), ("horizon_s", 0.5)):
        wrong: dict[str, Any] = {**request, name: value}
        with pytest.raises(InvalidRequest, match=name):
            client.plan(**wrong)


def test_an_open_horizon_needs_its_range(
    description: BundleDescription, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = L2Config(map_size=16, feature_channels=4, layers=1)
    adapter = flowmp_adapter(L2SafetyCFM(config), ExportChoices(ranges={}))
    # It is refused at once, not after a minute of tracing.
    monkeypatch.setattr(type(adapter), "trace", lambda _: pytest.fail("it was traced"))
    with pytest.raises(ExportError, match=r"ranges\.horizon_s"):
        export_bundle(adapter, description, out=tmp_path / "bundle")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["a b/c", "flow*", "größe", ""])
def test_a_name_that_no_key_can_hold_is_refused(
    name: str, tmp_path: Path, small_flow: Any, description: Any, adapted: Any
) -> None:
    out = tmp_path / "bundle"
    with pytest.raises(ExportError, match=r"name: .*expected a name without spaces"):
        export_bundle(adapted(small_flow()), replace(description, name=name), out=out)
    assert not out.exists()


def test_wider_noise_is_the_bundles_own() -> None:
    model = L2SafetyCFM(L2Config(map_size=16, feature_channels=4))
    before = model.prior.factor.clone()
    choices = ExportChoices(noise_scale=1.4)
    for _ in range(2):
        adapted = flowmp_adapter(model, choices).roles["encode"].model
        torch.testing.assert_close(adapted.prior.factor, 1.4 * before)
    torch.testing.assert_close(model.prior.factor, before)
