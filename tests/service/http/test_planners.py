"""What every planner without a cost map promises, whatever carries its requests.

A camera planner worked out by hand, the GoalFlow that ships, a small one on sensors and a small
WoTE, over JSON, binary and zenoh.
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from driven_bend import bend
from exported_bundles import SENSING, WOTE, export_once
from image_planner import HEIGHT, WIDTH, K, expected, write_image_bundle
from served import TRANSPORTS, client_over
from tiny_wote import sensors, tiny_wote

from anchorflow_client import AnchorBatch
from anchorflow_client.base_client import BaseClient
from anchorflow_client.contract.batch import FUTURE_PROBABILITIES, FUTURES
from anchorflow_client.errors import InvalidRequest
from anchorflow_driving.sensors.bev import draw_bev
from anchorflow_driving.sensors.inputs import status_of
from anchorflow_driving.sensors.others import others_seen
from anchorflow_driving.window import Scenes
from anchorflow_export.planners.random_requests import street_request
from anchorflow_models.goalflow import GoalFlowConfig
from anchorflow_service.bundle import DEFAULT_BUNDLE, BundleError, load_bundle
from anchorflow_service.engine.samplers import SAMPLERS
from anchorflow_service.local import LocalClient
from anchorflow_service.planning import PlanningService, ServiceLimits

Inputs = dict[str, np.ndarray]
SPEED = 3.0
STATUS = np.array([SPEED, 0.0, 0.0, 0.0], np.float32)
OF_EACH = ("offsets", "im_rewards", "sim_rewards")
OF_THE_SCENE = ("agents", "agent_scores", "bev_semantics")


def picture(grey: int) -> np.ndarray:
    return np.full((3, HEIGHT, WIDTH), grey, np.uint8)


def camera_scene(scene: int) -> Inputs:
    return {"camera": picture((153, 0, 100, 255)[scene]), "ego_status": STATUS}


def goalflow_scene(scene: int) -> Inputs:
    view = Scenes(bend(scene % 2))[scene // 2].view
    size = view.vehicle.size.astype(np.float32)
    return {
        "bev": draw_bev(view),
        "ego_status": status_of(view),
        "vehicle_size": size,
        "others": others_seen(view),
    }


def wote_scene(scene: int) -> Inputs:
    return {name: tensor[scene].numpy() for name, tensor in sensors(WOTE, 4).items()}


@dataclass
class Planner:
    """A bundle, scenes to ask it about, and what its card says."""

    path: Path
    scene: Callable[[int], Inputs]
    extras: tuple[str, ...]
    sampler: str
    steps: int
    finish: str
    optional: tuple[str, ...] = ()
    options: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.local = LocalClient.of(self.path, threads=1)
        self.all: dict[str, Any] = {
            "inputs": self.scene(0),
            "outputs": [*self.extras],
            **self.options,
        }
        """The arguments of a request with every output."""


def camera_planner(factory: pytest.TempPathFactory) -> Planner:
    extras = ("goals", "bev_semantics")
    return Planner(
        write_image_bundle(factory.mktemp("camera")), camera_scene, extras, "vocabulary", 8, "none"
    )


def goalflow_planner(_: pytest.TempPathFactory) -> Planner:
    path = DEFAULT_BUNDLE.parent / "goalflow"
    options = {"num_samples": 12, "seed": 3, "sampler": {"schedule": {"uniform": 3}}}
    extras = ("goals", "goal_scores", FUTURES, FUTURE_PROBABILITIES)
    optional = ("route", "others")
    return Planner(path, goalflow_scene, extras, "ode", 8, "guard", optional, options)


def wote_planner(_: pytest.TempPathFactory) -> Planner:
    made = export_once("wote")
    assert max(part.error for part in made.differences) <= 1e-5
    extras, optional = (*OF_EACH, *OF_THE_SCENE), ("lidar_before", "route")
    return Planner(made.path, wote_scene, extras, "vocabulary", WOTE.num_steps, "guard", optional)


def sensing_planner(_: pytest.TempPathFactory) -> Planner:
    made = export_once("goalflow-sensors")
    card = load_bundle(made.path).card
    asked = street_request(SENSING.bev, card, {"B": 4}, 0).inputs

    def scene(scene: int) -> Inputs:
        return {name: np.asarray(array)[scene] for name, array in asked.items() if name != "route"}

    extras, optional = ("goals", "goal_scores"), ("lidar_before", "route")
    options = {"num_samples": 12, "seed": 3, "sampler": {"schedule": {"uniform": 3}}}
    return Planner(made.path, scene, extras, "ode", SENSING.num_steps, "guard", optional, options)


PLANNERS = {
    "camera": camera_planner,
    "goalflow": goalflow_planner,
    "goalflow-sensors": sensing_planner,
    "wote": wote_planner,
}


@pytest.fixture(scope="module")
def opened() -> dict[str, Planner]:
    return {}


@pytest.fixture(scope="module", params=PLANNERS)
def planner(
    request: pytest.FixtureRequest,
    opened: dict[str, Planner],
    tmp_path_factory: pytest.TempPathFactory,
) -> Planner:
    if request.param not in opened:
        opened[request.param] = PLANNERS[request.param](tmp_path_factory)
    return opened[request.param]


@pytest.fixture(scope="module", params=TRANSPORTS)
def client(request: pytest.FixtureRequest, planner: Planner) -> Iterator[BaseClient]:
    engine = planner.local.engine
    name, limits = engine.card.name, ServiceLimits(threads=2)
    with client_over(
        request.param, PlanningService({name: engine}, default=name, limits=limits)
    ) as client:
        yield client


def of(*names: str) -> Any:
    """Run a test for these planners alone."""
    return pytest.mark.parametrize("planner", names, indirect=True)


def assert_same(got: AnchorBatch, wanted: AnchorBatch) -> None:
    assert list(got.arrays) == list(wanted.arrays)
    for name, array in wanted.arrays.items():
        # JSON carries extras as doubles.
        np.testing.assert_array_equal(got.arrays[name].astype(array.dtype), array, err_msg=name)


def test_the_card_says_how_to_ask(planner: Planner, client: BaseClient) -> None:
    (card,) = client.models()

    assert card == planner.local.engine.card
    names = {spec.name for spec in card.inputs}
    optional = tuple(spec.name for spec in card.inputs if spec.optional)
    assert names - set(optional) <= set(planner.scene(0)) <= names
    assert optional == planner.optional
    kinds = (card.conditioning.kind, card.sampler.kind, card.finish.kind)
    assert kinds == ("tensors", planner.sampler, planner.finish)
    assert (card.T, card.D, card.time.first_s, card.time.dt) == (planner.steps, 3, 0.5, 0.5)
    assert set(card.answer.names) == {"trajectories", "scores", *planner.extras}
    with pytest.raises(InvalidRequest, match=f"{card.name} takes no cost map; its inputs are "):
        _ = card.cost_map


def test_an_answer_is_the_engines(planner: Planner, client: BaseClient) -> None:
    answer = client.plan(**planner.all)

    assert list(answer.arrays) == ["trajectories", "scores", *planner.extras]
    assert (answer.first_s, answer.dt, answer.model) == (0.5, 0.5, planner.local.engine.card.id)
    assert_same(answer, planner.local.plan(**planner.all))
    assert list(client.plan(inputs=planner.scene(0)).arrays) == ["trajectories", "scores"]
    with pytest.raises(LookupError, match=f"clearance: {answer.model.name} gives none"):
        _ = answer.clearance
    with pytest.raises(InvalidRequest, match=r"outputs: expected one of .*, got"):
        client.plan(inputs=planner.scene(0), outputs=["depth"])


def test_a_batch_equals_its_scenes_alone(planner: Planner) -> None:
    """An input that is the same in all scenes is sent once."""
    scenes = [planner.scene(scene) for scene in range(4)]
    stacked = {name: np.stack([each[name] for each in scenes]) for name in scenes[0]}
    once = {
        name: array[0] if (array == array[0]).all() else array for name, array in stacked.items()
    }
    together = planner.local.plan(**dict(planner.all, inputs=once))

    assert together.trajectories.shape[0] == 4
    for scene, inputs in enumerate(scenes):
        alone = planner.local.plan(**dict(planner.all, inputs=inputs))
        for name, array in alone.arrays.items():
            assert together.arrays[name][scene].tobytes() == array.tobytes(), name


def test_threads_do_not_change_an_answer(planner: Planner) -> None:
    wide = LocalClient.of(planner.path, threads=2)

    assert_same(wide.plan(**planner.all), planner.local.plan(**planner.all))


@of("camera", "wote")
def test_of_a_vocabulary_num_samples_are_the_best_n(planner: Planner, client: BaseClient) -> None:
    all_of_them = client.plan(inputs=planner.scene(0))
    some = client.plan(inputs=planner.scene(0), num_samples=2)

    assert all_of_them.best == 0
    assert (np.diff(all_of_them.scores) <= 0).all()
    np.testing.assert_array_equal(some.trajectories, all_of_them.trajectories[:2])
    np.testing.assert_array_equal(some.scores, all_of_them.scores[:2])
    most = len(all_of_them.scores)
    with pytest.raises(InvalidRequest, match=rf"num_samples: expected 1 to {most}, .* got 99"):
        client.plan(inputs=planner.scene(0), num_samples=99)


REFUSED: dict[tuple[str, str], tuple[dict[str, Any], str]] = {
    ("camera", "missing"): ({"camera": None}, "inputs.camera: this field is required"),
    ("camera", "unknown"): ({"radar": [1.0]}, "inputs.radar: unknown field"),
    ("camera", "another dtype"): (
        {"camera": picture(3).astype(np.float32)},
        "inputs.camera: expected uint8 [3,16,24] or [B,3,16,24], got an array of float32",
    ),
    ("camera", "another shape"): (
        {"camera": picture(3)[:, :8]},
        "got an array of uint8 and shape [3, 8, 24]",
    ),
    ("camera", "seven numbers"): (
        {"ego_status": np.zeros(7, np.float32)},
        "inputs.ego_status: expected shape [4] or [B,4], got ",
    ),
    ("camera", "not a number"): (
        {"ego_status": np.array([0, np.nan, 0, 0], np.float32)},
        "expected finite numbers, got nan at inputs.ego_status[1]",
    ),
    ("camera", "out of range"): (
        {"ego_status": np.array([0, 0, 99, 0], np.float32)},
        "got 99.0 at inputs.ego_status[2]",
    ),
    ("camera", "text"): ({"ego_status": "fast"}, "inputs.ego_status: expected float32, got text"),
    ("camera", "batches that differ"): (
        {"ego_status": np.stack([STATUS] * 3), "camera": np.stack([picture(1)] * 2)},
        "inputs.ego_status: expected B = 2 as in inputs.camera, got 3",
    ),
    ("goalflow", "faster than a street's cars"): (
        {"ego_status": np.array([0, 1, 0, 0, 40, 0, 0, 0], np.float32)},
        "expected numbers in [-32, 32] command left, straight, right, unknown: 0 or 1; velocity",
    ),
    ("goalflow", "a size below a bicycle's"): (
        {"vehicle_size": np.array([4.0, 0.0], np.float32)},
        "expected numbers in [0.3, 30] m, got 0.0 at inputs.vehicle_size[1]",
    ),
    ("goalflow", "integers of 32 bits"): (
        {"vehicle_size": np.array([4, 0], np.int32)},
        "expected numbers in [0.3, 30] m, got 0.0 at inputs.vehicle_size[1]",
    ),
}


@pytest.mark.parametrize(
    ("planner", "change", "words"),
    [pytest.param(key[0], *case, id=", ".join(key)) for key, case in REFUSED.items()],
    indirect=["planner"],
)
def test_what_is_not_the_cards_is_refused_by_name(
    planner: Planner, client: BaseClient, change: dict[str, Any], words: str
) -> None:
    inputs = {name: each for name, each in (planner.scene(0) | change).items() if each is not None}

    with pytest.raises(InvalidRequest, match=re.escape(words)) as caught:
        client.plan(inputs=inputs)
    assert caught.value.field == f"inputs.{next(iter(change))}"


@of("camera", "wote")
@pytest.mark.parametrize(
    "fields",
    [
        {"v_max": 3.0},
        {"sampler": {"method": "rk4"}},
        {"refine": {"smooth": True}},
        {"warm_start": {"trajectory": [[0, 0], [1, 1]]}},
        {"obstacles": {"position": [[1, 0]], "velocity": [[0, 1]], "radius": [0.3]}},
    ],
    ids=lambda fields: next(iter(fields)),
)
def test_what_a_vocabulary_has_no_use_for_is_refused(
    planner: Planner, client: BaseClient, fields: dict[str, Any]
) -> None:
    with pytest.raises(InvalidRequest) as caught:
        client.plan(inputs=planner.scene(0), **fields)
    assert str(caught.value.field).split(".")[0] == next(iter(fields))


@of("goalflow", "goalflow-sensors", "wote")
def test_the_guard_is_answered_alike(planner: Planner, client: BaseClient) -> None:
    asked: dict[str, Any] = planner.all | {"refine": {"guard": True}}
    answer = client.plan(**asked)
    assert_same(answer, planner.local.plan(**asked))
    assert answer.safe.dtype == np.bool_
    assert (answer.reason is None) == answer.safe.any()


def test_a_map_is_refused(planner: Planner, client: BaseClient) -> None:
    name = planner.local.engine.card.name
    with pytest.raises(InvalidRequest, match=rf"cost_map: unknown to {name}.* inputs\."):
        client.plan(
            cost_map=np.zeros((16, 16)), resolution=0.5, x_curr=[0.0] * 6, x_goal=[1.0, 0, 0, 0]
        )


@of("camera")
@pytest.mark.parametrize("grey", [153, 40])
def test_the_cameras_answer_is_the_one_worked_out_by_hand(
    planner: Planner, client: BaseClient, grey: int
) -> None:
    inputs = planner.scene(0) | {"camera": picture(grey)}
    anchors = client.plan(inputs=inputs, outputs=["goals", "bev_semantics"])

    paths, scores = expected(grey / 255, SPEED)
    assert len(anchors.scores) == K
    np.testing.assert_allclose(anchors.trajectories, paths, atol=1e-5)
    np.testing.assert_allclose(anchors.scores, scores, atol=1e-4)
    np.testing.assert_array_equal(anchors.arrays["goals"], anchors.trajectories[:, -1, :2])
    np.testing.assert_allclose(anchors.arrays["bev_semantics"], picture(grey) / 255, rtol=1e-6)


@of("goalflow")
def test_noise_makes_draws_to_one_goal_differ(planner: Planner) -> None:
    # Ways are dealt out in turn, those to goals first; turns and halts, which no noise moves, last.
    config = GoalFlowConfig(picked=31)
    again, once = config.picked, config.ways - config.along
    drawn = {name: array for name, array in planner.scene(0).items() if name != "others"}
    asked: dict[str, Any] = {"inputs": drawn, "num_samples": once + again}
    first, second = (planner.local.plan(**asked, seed=seed).trajectories for seed in (1, 2))

    apart = np.abs(first[:again] - first[-again:]).max((1, 2))
    assert (apart > 1e-4).all()
    assert (np.abs(first[:again, -1, :2] - first[-again:, -1, :2]).max(1) < 5.0).all()
    assert np.abs(second - first).max() > 1e-4


@of("goalflow")
def test_goalflow_scores_are_probabilities_of_its_goals(planner: Planner) -> None:
    answer = planner.local.plan(**planner.all)

    assert answer.arrays["goals"].shape == (GoalFlowConfig().goals, 2)
    assert ((answer.scores >= 0) & (answer.scores <= 1)).all()


@of("goalflow")
def test_a_bundle_whose_score_is_wired_wrongly_is_refused(planner: Planner) -> None:
    manifest = load_bundle(planner.path).manifest
    graphs = dict(manifest.graphs)
    score = graphs["score"]
    renamed = tuple(replace(spec, name=spec.name.replace("x_1", "x_2")) for spec in score.inputs)
    graphs["score"] = score.model_copy(update={"inputs": renamed})
    (fault,) = SAMPLERS["ode"].faults(manifest.model_copy(update={"graphs": graphs}))
    assert fault.startswith("graphs.score.inputs: 'x_2' is not one of x_1, prior_mean, ")


@of("wote")
def test_wotes_answer_and_rewards_are_torchs(planner: Planner) -> None:
    anchors = planner.local.plan(**planner.all, num_samples=3)

    model = tiny_wote(WOTE)
    with torch.inference_mode():
        context = model.encode(**{name: each[:1] for name, each in sensors(WOTE, 4).items()})
        given = model.score(**{name: context[name] for name in model.context_for_score})
    best = given["scores"][0].argsort(descending=True)[:3]
    for name, got in anchors.arrays.items():
        wanted = context[name][0] if name in OF_THE_SCENE else given[name][0, best]
        np.testing.assert_allclose(got, wanted, rtol=1e-4, atol=1e-4, err_msg=name)
    assert anchors.arrays["sim_rewards"].shape == (3, 5)
    assert anchors.arrays["agents"].shape == (4, 5)
    np.testing.assert_allclose(anchors.arrays["bev_semantics"].sum(0), 1.0, rtol=1e-5)


@pytest.mark.parametrize(
    ("planner", "name", "extent"),
    [
        ("goalflow", "bev", (-16.0, 80.0, -32.0, 32.0)),
        ("wote", "bev_semantics", (0.0, 32.0, -32.0, 32.0)),
    ],
    indirect=["planner"],
)
def test_the_card_says_what_a_raster_covers(
    planner: Planner, name: str, extent: tuple[float, ...]
) -> None:
    card = planner.local.engine.card
    specs = {spec.name: spec for spec in (*card.inputs, *card.answer.extras)}

    assert specs[name].extent == extent
    if lidar := specs.get("lidar"):
        assert lidar.unit == "rows x, columns y, both from -32 to 32 m"


@of("wote")
def test_an_optional_input_of_open_size_is_refused(planner: Planner, tmp_path: Path) -> None:
    copy = shutil.copytree(planner.path, tmp_path / "open")
    manifest = json.loads((copy / "manifest.json").read_text())
    inputs = {each["name"]: each for each in manifest["request"]["inputs"]}
    inputs["lidar_before"]["shape"] = ["B", 1, "H", "W"]
    (copy / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(BundleError, match="lidar_before is optional, expected a fixed size"):
        LocalClient.of(copy, threads=1)


@of("wote")
def test_an_earlier_sweep_may_be_left_out(planner: Planner) -> None:
    scenes = [planner.scene(scene) for scene in range(2)]
    for each in scenes:
        del each["lidar_before"]
    together = planner.local.plan(
        inputs={name: np.stack([each[name] for each in scenes]) for name in scenes[0]}
    )
    for scene, inputs in enumerate(scenes):
        alone = planner.local.plan(inputs=inputs)
        assert together.trajectories[scene].tobytes() == alone.trajectories.tobytes()

    missing, sweep = planner.local.plan(inputs=scenes[0]), np.zeros_like(scenes[0]["lidar"])
    empty = planner.local.plan(inputs={**scenes[0], "lidar_before": sweep})
    full = planner.local.plan(inputs={**scenes[0], "lidar_before": sweep + 1})
    assert missing.trajectories.tobytes() == empty.trajectories.tobytes()
    assert np.abs(full.arrays["scores"] - empty.arrays["scores"]).max() > 1e-6
    assert (missing.absent_inputs, full.absent_inputs) == (("lidar_before", "route"), ("route",))
