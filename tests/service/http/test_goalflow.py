"""GoalFlow from a network to answers: exported, and asked over every transport."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from driven_bend import bend
from exported_bundles import GOALFLOW, export_once

from anchorflow_client import AnchorBatch, AnchorClient, JsonCodec, OipCodec
from anchorflow_client.errors import InvalidRequest
from anchorflow_driving.sensors.bev import draw_bev
from anchorflow_driving.sensors.inputs import status_of
from anchorflow_driving.window import Scenes
from anchorflow_service.bundle import load_bundle
from anchorflow_service.engine.samplers import SAMPLERS
from anchorflow_service.http import create_app
from anchorflow_service.local import LocalClient
from anchorflow_service.planning import PlanningService, ServiceLimits

MODEL, K, N, T = "small-goalflow", GOALFLOW.goals, 12, GOALFLOW.num_steps


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = export_once("goalflow", tmp_path_factory.getbasetemp())
    assert max(difference.error for difference in made.differences) < 1e-4
    return made.path


@pytest.fixture(scope="module")
def planning(bundle: Path) -> PlanningService:
    engine = LocalClient.of(bundle, threads=1).engine
    return PlanningService({MODEL: engine}, default=MODEL, limits=ServiceLimits(threads=2))


@pytest.fixture(scope="module")
def local(bundle: Path) -> LocalClient:
    return LocalClient.of(bundle, threads=1)


@pytest.fixture(params=[JsonCodec(), OipCodec()], ids=["json", "binary"])
def client(
    request: pytest.FixtureRequest, planning: PlanningService, run: Any
) -> Iterator[AnchorClient]:
    transport = run(create_app(planning))
    with AnchorClient("http://test", transport=transport, codec=request.param) as client:
        yield client


def inputs_of(window: int) -> dict[str, np.ndarray]:
    view = Scenes(bend(window % 2))[window // 2].view
    return {
        "bev": draw_bev(view),
        "ego_status": status_of(view),
        "vehicle_size": view.vehicle.size.astype(np.float32),
    }


def assert_same(got: AnchorBatch, expected: AnchorBatch) -> None:
    assert list(got.arrays) == list(expected.arrays)
    for name, array in expected.arrays.items():
        # JSON carries extras as doubles.
        np.testing.assert_array_equal(got.arrays[name].astype(array.dtype), array, err_msg=name)


def test_the_card_says_how_to_ask(local: LocalClient) -> None:
    (card,) = local.models()

    assert [spec.name for spec in card.inputs] == ["bev", "ego_status", "vehicle_size", "route"]
    assert [spec.name for spec in card.inputs if spec.optional] == ["route"]
    assert card.inputs[0].shape == ("B", 20, 192, 128)
    assert card.inputs[0].extent == (-16.0, 80.0, -32.0, 32.0)
    assert (card.conditioning.kind, card.sampler.kind, card.finish.kind) == (
        "tensors",
        "ode",
        "none",
    )
    assert (card.T, card.D, card.time.first_s, card.time.dt) == (T, 3, 0.5, 0.5)
    assert card.answer.names == ("trajectories", "scores", "goals", "goal_scores")


def test_an_answer_over_http_is_the_engines(client: AnchorClient, local: LocalClient) -> None:
    asked: dict[str, Any] = {
        "inputs": inputs_of(0),
        "num_samples": N,
        "seed": 3,
        "outputs": ["goals", "goal_scores"],
        "sampler": {"schedule": {"uniform": 3}},
    }
    answer = client.plan(**asked)

    assert answer.trajectories.shape == (N, T, 3)
    assert answer.scores.shape == (N,)
    assert answer.arrays["goals"].shape == (K, 2)
    assert ((answer.scores >= 0) & (answer.scores <= 1)).all()
    assert_same(answer, local.plan(**asked))


def test_a_batch_of_eight_equals_eight_alone(local: LocalClient) -> None:
    windows = [inputs_of(k % 6) for k in range(8)]
    stacked = {name: np.stack([each[name] for each in windows]) for name in windows[0]}
    extras = ["goals", "goal_scores"]
    together = local.plan(inputs=stacked, num_samples=N, seed=1, outputs=extras)

    for scene, inputs in enumerate(windows):
        alone = local.plan(inputs=inputs, num_samples=N, seed=1, outputs=extras)
        for name, array in alone.arrays.items():
            assert together.arrays[name][scene].tobytes() == array.tobytes(), name


def test_threads_do_not_change_an_answer(bundle: Path, local: LocalClient) -> None:
    wide = LocalClient.of(bundle, threads=2)
    asked: dict[str, Any] = {"inputs": inputs_of(2), "num_samples": 40, "seed": 5}

    assert_same(wide.plan(**asked), local.plan(**asked))


def test_noise_makes_draws_to_one_goal_differ(local: LocalClient) -> None:
    # Ways are dealt out in turn, those to goals first; turns and halts, which no noise moves, last.
    again, once = GOALFLOW.picked, GOALFLOW.ways - GOALFLOW.along
    asked: dict[str, Any] = {"inputs": inputs_of(0), "num_samples": once + again}
    first, second = (local.plan(**asked, seed=seed).trajectories for seed in (1, 2))

    apart = np.abs(first[:again] - first[-again:]).max((1, 2))
    assert (apart > 1e-4).all()
    assert (np.abs(first[:again, -1, :2] - first[-again:, -1, :2]).max(1) < 5.0).all()
    assert np.abs(second - first).max() > 1e-4


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "faster than a street's cars": (
        {"ego_status": np.array([0, 1, 0, 0, 40, 0, 0, 0], np.float32)},
        "expected numbers in [-32, 32] command left, straight, right, unknown: 0 or 1; velocity",
    ),
    "a size below a bicycle's": (
        {"vehicle_size": np.array([4.0, 0.0], np.float32)},
        "expected numbers in [0.3, 30] m, got 0.0 at inputs.vehicle_size[1]",
    ),
    "integers of 32 bits": (
        {"vehicle_size": np.array([4, 0], np.int32)},
        "expected numbers in [0.3, 30] m, got 0.0 at inputs.vehicle_size[1]",
    ),
}


@pytest.mark.parametrize("case", WRONG, ids=list(WRONG))
def test_what_is_wrong_is_named(client: AnchorClient, case: str) -> None:
    changed, message = WRONG[case]
    with pytest.raises(InvalidRequest, match=re.escape(message)):
        client.plan(inputs=inputs_of(0) | changed)


def test_a_bundle_whose_score_is_wired_wrongly_is_refused(bundle: Path) -> None:
    manifest = load_bundle(bundle).manifest
    graphs = dict(manifest.graphs)
    score = graphs["score"]
    renamed = tuple(replace(spec, name=spec.name.replace("x_1", "x_2")) for spec in score.inputs)
    graphs["score"] = score.model_copy(update={"inputs": renamed})
    changed = manifest.model_copy(update={"graphs": graphs})
    (fault,) = SAMPLERS["ode"].faults(changed)
    assert fault.startswith("graphs.score.inputs: 'x_2' is not one of x_1, prior_mean, ")
