"""DiffusionDriveV2 exported, proved equal to torch, and served."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from onnx import ModelProto
from tiny_diffusiondrive import TINY, tiny_diffusiondrive
from torch import nn

from anchorflow_client.contract import TensorSpec, TruncatedDiffusionSpec
from anchorflow_client.errors import InvalidRequest
from anchorflow_export.adapter import ExportChoices, TracedGraph
from anchorflow_export.bundle import BundleDescription, export_bundle
from anchorflow_export.parity import Difference
from anchorflow_export.planners import adapter_of
from anchorflow_export.planners.diffusiondrive import adapter as adapter_module
from anchorflow_service.bundle import load_bundle
from anchorflow_service.bundle.manifest import TruncatedDiffusionEntry
from anchorflow_service.local import LocalClient

DESCRIPTION = BundleDescription(name="tiny", version="1.0.0", planner="diffusiondrive")
EXTRAS = (
    *("coarse_scores", "sub_scores", "direction_scores"),
    *("agents", "agent_scores", "bev_semantics"),
)
CANDIDATES = 4 * 2 * 2 + 3
SMALL = replace(
    TINY,
    backbone=replace(TINY.backbone, lidar_before=True),
    encounters=TINY.footprint,
    ground_sight=True,
    driven=True,
    direction=True,
    imitation=0.1,
    pessimistic=True,
)


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, tuple[Difference, ...]]:
    out = tmp_path_factory.mktemp("diffusiondrive") / "tiny"
    # With all that the small preset has and the published planner has not.
    model = tiny_diffusiondrive(SMALL)
    adapter = adapter_of("diffusiondrive", model, ExportChoices())
    return out, export_bundle(adapter, DESCRIPTION, out=out)


@pytest.fixture(scope="module")
def client(exported: tuple[Path, Any]) -> LocalClient:
    return LocalClient.of(exported[0], threads=2)


def sensors(B: int | None = None) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(3)
    lead = () if B is None else (B,)
    return {
        "camera": rng.integers(0, 256, (*lead, 3, 16, 32), dtype=np.uint8),
        "lidar": rng.random((*lead, 1, 16, 16), dtype=np.float32),
        "ego_status": rng.standard_normal((*lead, 8), dtype=np.float32),
    }


def test_every_stage_and_every_number_of_steps_is_proved(
    exported: tuple[Path, tuple[Difference, ...]],
) -> None:
    whats = " ".join(difference.what for difference in exported[1])
    for stage in ("encode", "denoise", "coarse", "fine", "1 steps", "2 steps", "4 steps"):
        assert f"{stage} " in whats
    assert max(difference.error for difference in exported[1]) <= 1e-4


@pytest.mark.parametrize(("noise_scale", "level"), [(1.0, 8), (0.45, 1), (0.1, 0), (1.5, 17)])
def test_anchors_begin_with_as_much_noise_as_is_asked_for(noise_scale: float, level: int) -> None:
    model = tiny_diffusiondrive()
    adapter = adapter_of("diffusiondrive", model, ExportChoices(noise_scale=noise_scale))
    sampler = adapter.parts.sampler
    assert isinstance(sampler, TruncatedDiffusionEntry)
    assert sampler.start == level


def test_no_graph_of_the_published_planner_takes_what_the_small_one_adds(
    exported: tuple[Path, tuple[Difference, ...]], monkeypatch: pytest.MonkeyPatch
) -> None:
    told = load_bundle(exported[0]).manifest.graphs
    published = tiny_diffusiondrive(replace(TINY, ego_motion=False))
    # What a graph takes and gives is settled before it is traced, and tracing takes half a minute.
    monkeypatch.setattr(adapter_module, "trace_role", untraced)
    plain = adapter_of("diffusiondrive", published, ExportChoices()).trace()
    for graphs, wanted in ((told, True), (plain, False)):
        scorers = [{spec.name for spec in graphs[role].inputs} for role in ("coarse", "fine")]
        for name in ("ego_motion", "foretold"):
            assert (name in {spec.name for spec in graphs["encode"].outputs}) is wanted
            assert [name in taken for taken in scorers] == [wanted, wanted]
        assert ("coarse_logits" in scorers[1]) is wanted
        told_last = {spec.name for spec in graphs["fine"].outputs}
        assert ("direction_scores" in told_last) is wanted


def untraced(
    _: nn.Module, __: str, *, inputs: Sequence[TensorSpec], outputs: Sequence[str]
) -> TracedGraph:
    told = tuple(TensorSpec(name, "float32", ()) for name in outputs)
    return TracedGraph(ModelProto(), tuple(inputs), told)


def test_the_card(client: LocalClient) -> None:
    card = client.engine.card
    spec = TruncatedDiffusionSpec(size=6, candidates=CANDIDATES, steps=2, choices=(1, 2, 4))
    assert (card.sampler, card.time.first_s, card.time.dt) == (spec, 0.5, 0.5)
    assert [spec.name for spec in card.answer.extras] == [*EXTRAS]
    semantics = card.answer.extras[-1]
    # The half of the LiDAR's square that lies ahead.
    assert (semantics.shape, semantics.extent) == (("B", 3, 8, 16), (0.0, 32.0, -32.0, 32.0))


def test_an_answer_holds_what_was_asked_for(client: LocalClient) -> None:
    plain = client.plan(inputs=sensors(), seed=1)
    assert {*plain.arrays} == {"trajectories", "scores"}
    assert plain.trajectories.shape == (TINY.keep, 8, 3)
    told = client.plan(inputs=sensors(), seed=1, num_samples=4, outputs=EXTRAS)
    shapes = {name: array.shape for name, array in told.arrays.items()}
    assert shapes == {
        "trajectories": (4, 8, 3),
        "scores": (4,),
        "coarse_scores": (4,),
        "sub_scores": (4, 5),
        "direction_scores": (4,),
        "agents": (30, 5),
        "agent_scores": (30,),
        "bev_semantics": (3, 8, 16),
    }
    np.testing.assert_array_equal(told.trajectories, plain.trajectories[:4])
    assert (np.diff(told.scores) <= 0).all()


def test_a_score_is_the_pdm_score_times_direction_and_likelihood(client: LocalClient) -> None:
    kept = client.plan(inputs=sensors(), seed=1, outputs=EXTRAS)
    nc, dac, ep, ttc, c = kept.arrays["sub_scores"].T
    direction = kept.arrays["direction_scores"]
    likelihood = kept.scores / (nc * dac * direction * (5 * ep + 5 * ttc + 2 * c) / 12)
    assert np.ptp(direction) > 1e-4
    assert likelihood.max() == pytest.approx(1.0, abs=1e-5)  # beside the likeliest of those kept
    assert 0.0 < likelihood.min() < 0.999


def test_a_batch_has_the_bytes_of_its_scenes(client: LocalClient) -> None:
    inputs = sensors(2)
    both = client.plan(inputs=inputs, seed=1)
    for b in range(2):
        alone = client.plan(inputs={name: array[b] for name, array in inputs.items()}, seed=1)
        assert both.trajectories[b].tobytes() == alone.trajectories.tobytes()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("camera", np.zeros((3, 16, 31), np.uint8)),
        ("camera", np.zeros((3, 16, 32), np.float32)),
        ("lidar", np.full((1, 16, 16), 5.0, np.float32)),
        ("ego_status", np.full(8, np.nan, np.float32)),
        ("ego_status", np.zeros(7, np.float32)),
    ],
)
def test_a_wrong_input_is_named(client: LocalClient, name: str, value: np.ndarray) -> None:
    with pytest.raises(InvalidRequest) as raised:
        client.plan(inputs=sensors() | {name: value})
    assert raised.value.field == f"inputs.{name}"
