"""DiffusionDriveV2 exported, proved equal to torch, and served."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from exported_bundles import DIFFUSION, export_once
from tiny_diffusiondrive import TINY, tiny_diffusiondrive

from anchorflow_client.contract import TruncatedDiffusionSpec
from anchorflow_export.adapter import ExportChoices
from anchorflow_export.planners import adapter_of
from anchorflow_service.bundle.entries import TruncatedDiffusionEntry
from anchorflow_service.local import LocalClient

EXTRAS = (
    *("coarse_scores", "sub_scores", "direction_scores", "poses_cls"),
    *("agents", "agent_scores", "bev_semantics"),
)
CANDIDATES = 4 * 2 * 2 + 3


@pytest.fixture(scope="module")
def client() -> LocalClient:
    return LocalClient.of(export_once("diffusiondrive").path, threads=2)


def sensors() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(3)
    return {
        "camera": rng.integers(0, 256, (3, 16, 32), dtype=np.uint8),
        "lidar": rng.random((1, 16, 16), dtype=np.float32),
        "ego_status": rng.standard_normal(8, dtype=np.float32),
    }


def test_every_number_of_steps_is_proved() -> None:
    whats = " ".join(part.what for part in export_once("diffusiondrive").differences)
    for steps in (1, 2, 4):
        assert f", {steps} steps" in whats


@pytest.mark.parametrize(("noise_scale", "level"), [(1.0, 8), (0.45, 1), (0.1, 0), (1.5, 17)])
def test_anchors_begin_with_as_much_noise_as_is_asked_for(noise_scale: float, level: int) -> None:
    model = tiny_diffusiondrive()
    adapter = adapter_of("diffusiondrive", model, ExportChoices(noise_scale=noise_scale))
    sampler = adapter.parts.sampler
    assert isinstance(sampler, TruncatedDiffusionEntry)
    assert sampler.start == level


def test_no_graph_of_the_published_planner_takes_what_the_small_one_adds() -> None:
    published = tiny_diffusiondrive(replace(TINY, ego_motion=False))
    for network, wanted in ((tiny_diffusiondrive(DIFFUSION), True), (published, False)):
        roles = adapter_of("diffusiondrive", network, ExportChoices()).roles
        for name in ("ego_motion", "foretold"):
            assert (name in roles["encode"].outputs) is wanted
            assert [name in roles[role].inputs for role in ("coarse", "fine")] == [wanted, wanted]
        assert ("coarse_logits" in roles["fine"].inputs) is wanted
        assert ("direction_scores" in roles["fine"].outputs) is wanted


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
        "poses_cls": (4,),
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
