"""WoTE through the whole house: exported, opened, asked over every transport."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from fastapi import FastAPI
from tiny_wote import TINY, sensors, tiny_wote

from anchorflow_client import AnchorBatch, AnchorClient, JsonCodec, OipCodec
from anchorflow_export.adapter import ExportChoices
from anchorflow_export.bundle import BundleDescription, export_bundle
from anchorflow_export.planners import adapter_of
from anchorflow_service.bundle import BundleError
from anchorflow_service.http import create_app
from anchorflow_service.local import LocalClient
from anchorflow_service.planning import PlanningService, ServiceLimits

MODEL = "tiny-wote"
# A bundle of two sweeps; tests/export compares one with a single sweep with torch.
CONFIG = replace(TINY, kept=5, driven=True, backbone=replace(TINY.backbone, lidar_before=True))
OF_EACH = ("offsets", "im_rewards", "sim_rewards")
OF_THE_SCENE = ("agents", "agent_scores", "bev_semantics")


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("wote") / "bundle"
    adapter = adapter_of("wote", tiny_wote(CONFIG), ExportChoices())
    description = BundleDescription(name=MODEL, version="1.0.0", planner="wote")
    differences = export_bundle(adapter, description, out=out)
    tried = {part.what.split(",")[0] for part in differences}
    assert tried == {f"{r} at B={B}" for r in ("encode", "score") for B in (1, 3)} | {
        "sample of scene 0"
    }
    assert max(part.error for part in differences) <= 1e-5
    return out


@pytest.fixture(scope="module")
def planning(bundle: Path) -> PlanningService:
    engine = LocalClient.of(bundle, threads=1).engine
    return PlanningService({MODEL: engine}, default=MODEL, limits=ServiceLimits(threads=1))


@pytest.fixture
def app(planning: PlanningService) -> FastAPI:
    return create_app(planning)


@pytest.fixture(params=[JsonCodec(), OipCodec()], ids=["json", "binary"])
def client(request: pytest.FixtureRequest, service: Any) -> Iterator[AnchorClient]:
    with AnchorClient("http://test", transport=service, codec=request.param) as client:
        yield client


def scenes(B: int = 1) -> dict[str, np.ndarray]:
    return {name: tensor.numpy() for name, tensor in sensors(CONFIG, B).items()}


def scene() -> dict[str, np.ndarray]:
    return {name: array[0] for name, array in scenes().items()}


def assert_torchs(anchors: AnchorBatch, *, outputs: tuple[str, ...]) -> None:
    model = tiny_wote(CONFIG)
    with torch.inference_mode():
        context = model.encode(**sensors(CONFIG, 1))
        given = model.score(**{name: context[name] for name in model.context_for_score})
    best = given["scores"][0].argsort(descending=True)[: anchors.trajectories.shape[0]]
    for name in ("trajectories", "scores", *outputs):
        wanted = context[name][0] if name in OF_THE_SCENE else given[name][0, best]
        got = anchors.arrays[name]
        np.testing.assert_allclose(got, wanted, rtol=1e-4, atol=1e-4, err_msg=name)


def test_the_best_come_first_with_their_rewards(client: AnchorClient) -> None:
    anchors = client.plan(inputs=scene(), num_samples=3, outputs=[*OF_EACH])
    assert list(anchors.arrays) == ["trajectories", "scores", *OF_EACH]
    assert (anchors.trajectories.shape, anchors.arrays["sim_rewards"].shape) == ((3, 8, 3), (3, 5))
    assert (anchors.first_s, anchors.dt) == (0.5, 0.5)
    assert_torchs(anchors, outputs=OF_EACH)


def test_what_is_where_is_told_where_it_is_asked_for(client: AnchorClient) -> None:
    anchors = client.plan(inputs=scene(), num_samples=1, outputs=[*OF_THE_SCENE])
    assert anchors.arrays["agents"].shape == (4, 5)
    np.testing.assert_allclose(anchors.arrays["bev_semantics"].sum(0), 1.0, rtol=1e-5)
    assert_torchs(anchors, outputs=OF_THE_SCENE)


def test_the_card_says_what_the_rasters_cover(client: AnchorClient) -> None:
    (card,) = client.models()
    specs = {spec.name: spec for spec in (*card.inputs, *card.answer.extras)}
    assert specs["lidar"].unit == "rows x, columns y, both from -32 to 32 m"
    assert specs["bev_semantics"].extent == (0.0, 32.0, -32.0, 32.0)
    assert (card.sampler.kind, card.planner) == ("vocabulary", "wote")


@pytest.fixture(scope="module")
def local(bundle: Path) -> LocalClient:
    return LocalClient.of(bundle, threads=1)


def test_an_optional_input_of_open_size_is_refused(bundle: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(bundle, tmp_path / "open")
    manifest = json.loads((copy / "manifest.json").read_text())
    manifest["request"]["inputs"][-1]["shape"] = ["B", 1, "H", "W"]
    (copy / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(BundleError, match="lidar_before is optional, expected a fixed size"):
        LocalClient.of(copy, threads=1)


def without_an_earlier_sweep(inputs: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: array for name, array in inputs.items() if name != "lidar_before"}


def test_an_earlier_sweep_may_be_left_out(local: LocalClient) -> None:
    alone = without_an_earlier_sweep(scene())
    missing = local.plan(inputs=alone, num_samples=3)
    sweep = np.zeros_like(alone["lidar"])
    empty = local.plan(inputs={**alone, "lidar_before": sweep}, num_samples=3)
    full = local.plan(inputs={**alone, "lidar_before": sweep + 1}, num_samples=3)
    assert missing.trajectories.tobytes() == empty.trajectories.tobytes()
    assert np.abs(full.arrays["scores"] - empty.arrays["scores"]).max() > 1e-6
    assert (missing.absent_inputs, full.absent_inputs) == (("lidar_before",), ())


def test_a_batch_without_an_earlier_sweep_is_its_scenes_alone(local: LocalClient) -> None:
    asked = without_an_earlier_sweep(scenes(2))
    together = local.plan(inputs=asked, num_samples=3)
    for b in range(2):
        own = {name: array[b] for name, array in asked.items()}
        alone = local.plan(inputs=own, num_samples=3)
        assert together.trajectories[b].tobytes() == alone.trajectories.tobytes()
