"""GoalFlow's adapter, a small bundle on features of one's own, and the bundle that ships."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch
from exported_bundles import GOALFLOW, export_once
from torch import Tensor, nn

from anchorflow_client.errors import InvalidRequest
from anchorflow_client.sensors import ego_status
from anchorflow_export.adapter import ExportChoices
from anchorflow_export.futures import others_spec
from anchorflow_export.parity import prove_parity
from anchorflow_export.planners.goalflow import WEIGHTS, bev_spec, goalflow_adapter
from anchorflow_export.tracing import ExportError, random_tensor, trace
from anchorflow_models.futures import FuturesConfig
from anchorflow_models.goalflow import BevLayout, GoalFlow, GoalFlowConfig
from anchorflow_models.goalflow.config import ScoreWeights
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_service.local import LocalClient
from anchorflow_training.checkpoint import load_checkpoint, restore_model

SHIPPED = DEFAULT_BUNDLE.parent / "goalflow"
OWN = ("trajectory_goals",)


GOALS = np.array([[20.0, 4.0], [12.0, -2.0], [28.0, 0.0]], np.float32)
CHECKPOINT = Path(__file__).parents[2] / "checkpoints" / "goalflow.pt"


def street() -> dict[str, np.ndarray]:
    """A car at 6 m/s on a straight road, in the order of `encode`."""
    bev = np.zeros((20, 192, 128), np.uint8)
    bev[0, :, 48:80] = bev[1, :, 63:65] = 255
    status = ego_status(command="straight", velocity=(6.0, 0.0), acceleration=(0.0, 0.0))
    return {"bev": bev, "ego_status": status, "vehicle_size": np.array([4.6, 1.9], np.float32)}


def test_the_spread_of_the_noise_is_the_bundles_and_not_the_networks() -> None:
    model = GoalFlow(GoalFlowConfig())
    adapter = goalflow_adapter(model, ExportChoices(noise_scale=2.0))
    assert (adapter.roles["encode"].model.noise_scale, model.noise_scale) == (2.0, 1.0)


def test_random_scenes_have_scores_that_differ() -> None:
    """Scores that are all zero would prove nothing."""
    adapter = goalflow_adapter(GoalFlow(GoalFlowConfig()), ExportChoices())
    with LocalClient.of(SHIPPED, threads=1) as client:
        inputs = adapter.request(client.engine.card, {"B": 1}, 0).inputs
        (scores,) = client.plan(inputs=inputs, num_samples=9, seed=0).scores
    assert scores.max() > 0.01
    assert scores.max() > 1.1 * scores.min()


def features() -> dict[str, np.ndarray]:
    """The same car, on features."""
    layout = GOALFLOW.bev
    shape = (layout.channels, layout.rows, layout.columns)
    bev = np.random.default_rng(0).standard_normal(shape, np.float32)
    return {**street(), "bev": bev}


@pytest.fixture(scope="module")
def asked() -> LocalClient:
    """A small GoalFlow whose requests may bring goals and weights."""
    return LocalClient.of(export_once("goalflow").path, threads=1)


def test_features_of_ones_own_are_served(asked: LocalClient) -> None:
    card = asked.engine.card
    assert (card.inputs[0].shape, card.finish.kind) == (("B", 64, 40, 27), "none")
    anchors = asked.plan(inputs=features(), num_samples=8, seed=0)
    assert anchors.trajectories.shape == (8, GOALFLOW.num_steps, 3)
    assert anchors.first_s == pytest.approx(GOALFLOW.dt)
    with pytest.raises(InvalidRequest, match=r"bev.*64"):
        asked.plan(inputs={**features(), "bev": features()["bev"][:20]}, num_samples=8)


class Surfaces(nn.Module):
    """What a graph makes of the raster alone."""

    def __init__(self, model: GoalFlow) -> None:
        super().__init__()
        self.model = model

    def forward(self, bev: Tensor) -> tuple[Tensor, ...]:
        cells = self.model.cells(bev)
        return cells, *self.model.surfaces(cells)


def test_a_drawn_raster_is_read_as_torch_reads_it() -> None:
    surfaces = Surfaces(GoalFlow(replace(GOALFLOW, bev=BevLayout(rows=40, columns=27))))
    spec = bev_spec(surfaces.model.config.bev)
    graph = trace(surfaces, inputs=[spec], outputs=("cells", "drivable", "occupied"))
    bev = random_tensor(spec, {"B": 3})
    session = onnxruntime.InferenceSession(graph.model.SerializeToString())
    for got, wanted in zip(session.run(None, {"bev": bev.numpy()}), surfaces(bev), strict=True):
        np.testing.assert_allclose(np.asarray(got), wanted.numpy(), rtol=1e-6)


def test_trajectories_are_drawn_to_the_goals_of_a_request_in_turn(asked: LocalClient) -> None:
    for count in (1, 3):
        told = asked.plan(
            inputs={**features(), "goal": GOALS[:count]}, num_samples=6, outputs=OWN, seed=0
        )
        np.testing.assert_array_equal(told.arrays[OWN[0]], np.resize(GOALS[:count], (6, 2)))
    plain = asked.plan(inputs=features(), num_samples=6, outputs=OWN, seed=0)
    assert {"goal", "score_weights", "route"} == {*plain.absent_inputs}
    assert len({*map(tuple, plain.arrays[OWN[0]].tolist())}) == 6
    two = {name: np.stack([array, array]) for name, array in features().items()}
    own = np.stack([GOALS, 0 * GOALS])  # the second has none
    both = asked.plan(inputs={**two, "goal": own}, num_samples=6, outputs=OWN, seed=0)
    np.testing.assert_array_equal(both.arrays[OWN[0]][0], np.resize(GOALS, (6, 2)))
    np.testing.assert_array_equal(both.trajectories[1], plain.trajectories)


@torch.no_grad()
def test_the_weights_that_ship_end_at_their_own_goal() -> None:
    """Left to themselves they miss the goal 4 m aside by two and more."""
    model = restore_model(load_checkpoint(CHECKPOINT))
    inputs = [torch.from_numpy(each)[None] for each in street().values()]
    context = model.encode(*inputs, goal=torch.from_numpy(GOALS)[None])
    mean = context["prior_mean"][:, :30]

    def missed() -> torch.Tensor:
        x = model.draw(torch.randn(1, 30, 24, generator=torch.Generator().manual_seed(0)), mean)
        x = x + model.field(x, mean, model.modulate(torch.zeros(1), context)[:, 0], context)
        return (x[0, :, -1, :2] - torch.from_numpy(GOALS).repeat(10, 1)).norm(dim=-1)

    assert missed()[::3].mean() > 2.0
    model.takes_goals = True
    assert missed().max() < 0.1


def test_a_score_has_the_weights_of_the_export_or_of_the_request(asked: LocalClient) -> None:
    def scores(**weights: float) -> np.ndarray:
        row = np.array([{**vars(ScoreWeights()), **weights}[name] for name in WEIGHTS], np.float32)
        inputs = {**features(), **({"score_weights": row} if weights else {})}
        return asked.plan(inputs=inputs, num_samples=16, seed=0).scores

    own = scores()
    np.testing.assert_allclose(scores(comfort=2.0), own, rtol=1e-4)  # as exported
    slow = scores(clear_speed=4.0)
    assert (slow >= 0.999 * own).all()
    assert (slow > 1.02 * own).any()
    model = GoalFlow(GoalFlowConfig())
    adapter = goalflow_adapter(model, ExportChoices(score={"comfort": 3.0}))
    assert adapter.roles["score"].model.config.score == ScoreWeights(comfort=3.0)
    for wrong, said in (
        ({"speed": 1.0}, "of route, goal, .* got speed"),
        ({"goal": -1.0}, "at le"),
    ):
        with pytest.raises(ExportError, match=f"score.*: expected {said}"):
            goalflow_adapter(model, ExportChoices(score=wrong))


def test_the_bundle_that_ships_takes_what_the_adapter_says() -> None:
    adapter = goalflow_adapter(GoalFlow(GoalFlowConfig()), ExportChoices())
    manifest = load_bundle(SHIPPED).manifest
    others = others_spec(FuturesConfig())  # of the graph beside
    assert manifest.request.inputs == (*adapter.parts.inputs, others)
    assert (manifest.finish, manifest.time) == (adapter.parts.finish, adapter.parts.time)
    assert manifest.graphs["encode"].inputs == adapter.parts.inputs


def test_the_checkpoint_has_the_weights_of_the_bundle_that_ships() -> None:
    saved = load_checkpoint(CHECKPOINT)
    bundle = load_bundle(SHIPPED)
    adapter = goalflow_adapter(restore_model(saved), ExportChoices())
    prove_parity(adapter, bundle, tolerance=1e-4)
    assert saved.config == bundle.manifest.training["config"]
    assert saved.step == bundle.manifest.training["steps"]


def test_at_the_greatest_speed_it_takes_the_bundle_that_ships_drives_on() -> None:
    """At 40 m/s and more it leaves its raster, however it brakes, and turns off the road."""
    bev = np.zeros((20, 192, 128), np.uint8)
    bev[0, :, 52:76] = bev[1, :, 63:65] = 255  # a straight road, and a lane that leads ahead
    inputs = {"bev": bev, "vehicle_size": np.array([4.6, 1.9], np.float32)}

    def status(speed: float) -> np.ndarray:
        return ego_status(command="straight", velocity=(speed, 0.0), acceleration=(0.0, 0.0))

    with LocalClient.of(SHIPPED, threads=1) as client:
        anchors = client.plan(inputs={**inputs, "ego_status": status(32.0)}, num_samples=64, seed=0)
        with pytest.raises(InvalidRequest, match=r"got 40\.0 at inputs\.ego_status\[4\]"):
            client.plan(inputs={**inputs, "ego_status": status(40.0)})

    plan = anchors.trajectories[anchors.best]
    assert 80.0 < plan[-1, 0] < 140.0
    assert (np.abs(plan[:, 1:]) < (0.5, 0.05)).all()
