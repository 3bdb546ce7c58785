"""A bundle small enough to be worked out by hand, and a service whose engines need none.

The bundle's prior is the scene's routes, and its field carries every anchor by the same amount,
and on its own route by half as fast again as that was:

    x_0 = mean + noise · basis          R = 3: one number moves all of p, one all of p' and one all
                                        of log duration
    dx/dt = 4 t³ · channel means + PULL · mean
                                        so x_1 = x_0 + channel means + PULL · mean, exactly, by
                                        Simpson's rule

The means of occupancy, traversability and risk move (p_x, p_y, p'_x) and once more (p'_y, p''_x,
p''_y); PULL is one half for p' and nothing else.
"""

from __future__ import annotations

import json
import shutil
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from image_planner import write_image_bundle
from onnx import numpy_helper
from written_graphs import write_graphs

from anchorflow_client import (
    AnchorBatch,
    AnchorRequest,
    AnswerSpec,
    CostMapSpec,
    LimitsSpec,
    ModelCard,
    OdeSpec,
    RefineSpec,
    TensorSpec,
    TimeSpec,
)
from anchorflow_client.contract import ResolvedRequest
from anchorflow_service.planning import PlanningService, ServiceLimits

T, S, R = 8, 7, 3
THRICE = "(modulation, modulation, modulation)"
PULL = np.array([0.0, 0.0, 0.5, 0.5, 0.0, 0.0, 0.0], np.float32)

ENCODE = """
<ir_version: 10, opset_import: ["": 20]>
encode (float[B,3,H,W] cost_map, float[B,6] x_curr)
    => (float[B,3,56] prior_basis, float[B,3] means)
<int64[2] sides = {2, 3}, int64[1] batch = {0}>
{
    total = ReduceMean <keepdims = 0> (cost_map, sides)
    means = Identity (total)
    size = Shape <start = 0, end = 1> (x_curr)
    rest = Constant <value_ints = [1, 1]> ()
    wide = Concat <axis = 0> (size, rest)
    one = Unsqueeze (basis, batch)
    prior_basis = Expand (one, wide)
}
"""

MODULATE = """
<ir_version: 10, opset_import: ["": 20]>
modulate (float[K] times, float[B,3] means) => (float[B,K,3] modulation)
<int64[2] around = {0, 2}, int64[1] times_axis = {1}, float four = {4.0}, float three = {3.0}>
{
    cubed = Pow (times, three)
    speed = Mul (cubed, four)
    rows = Unsqueeze (speed, around)
    columns = Unsqueeze (means, times_axis)
    modulation = Mul (rows, columns)
}
"""

FIELD = """
<ir_version: 10, opset_import: ["": 20]>
field (float[B,N,8,7] x_t, float[B,N,8,7] prior_mean, float[B,3] modulation)
    => (float[B,N,8,7] dx_t)
<int64[2] inner = {1, 2}>
{
    twice = Concat <axis = 1> (modulation, modulation)
    lasting = Constant <value_ints = [0, 0, 0, 1]> ()
    carried = Pad (twice, lasting)
    speed = Unsqueeze (carried, inner)
    along = Mul (prior_mean, pull)
    dx_t = Add (along, speed)
}
"""


def _graphs() -> dict[str, onnx.ModelProto]:
    graphs = _parsed(ENCODE, MODULATE, FIELD)
    basis = np.zeros((R, T, S), np.float32)
    basis[0, :, 0:2] = basis[1, :, 2:4] = basis[2, :, 6] = 0.1
    constants = {"encode": ("basis", basis.reshape(R, T * S)), "field": ("pull", PULL)}
    for role, (name, array) in constants.items():
        graphs[role].graph.initializer.append(numpy_helper.from_array(array, name))
    return graphs


def _parsed(*texts: str) -> dict[str, onnx.ModelProto]:
    return dict(
        zip(("encode", "modulate", "field"), map(onnx.parser.parse_model, texts), strict=True)
    )


def _graphs_with_heading() -> dict[str, onnx.ModelProto]:
    """The same for D = 3, S = 10: the means move (p_x, p_y, heading) and their derivatives too."""
    wider = {"[B,6]": "[B,9]", "8,7]": "8,10]", "2,56]": "2,80]", "3,56]": "3,80]"}
    texts = [ENCODE, MODULATE, FIELD.replace("(modulation, modulation)", THRICE)]
    for narrow, wide in wider.items():
        texts = [text.replace(narrow, wide) for text in texts]
    graphs = _parsed(*texts)
    basis = np.zeros((R, T, 10), np.float32)
    basis[0, :, 0:3] = basis[1, :, 3:6] = basis[2, :, 9] = 0.1
    constants = {
        "encode": ("basis", basis.reshape(R, T * 10)),
        "field": ("pull", np.repeat(PULL, [1, 2, 1, 2, 1, 2, 1])),
    }
    for role, (name, array) in constants.items():
        graphs[role].graph.initializer.append(numpy_helper.from_array(array, name))
    return graphs


def _write_bundle(folder: Path) -> None:
    entries = write_graphs(folder, _graphs())
    manifest = {
        "format": 2,
        "name": "tiny",
        "version": "1.2.3",
        "planner": "by-hand",
        "request": {
            "inputs": [
                {"name": "cost_map", "dtype": "float32", "shape": ["B", "C", "H", "W"]},
                {"name": "x_curr", "dtype": "float64", "shape": ["B", 6], "unit": "m"},
            ]
        },
        "conditioning": {
            "kind": "cost_map",
            "channels": 3,
            "H": 16,
            "W": 16,
            "limits": {"horizon_s": 7.0, "v_max": 2.0, "a_max": 3.0, "robot_radius": 0.25},
            "ranges": {"robot_radius": [0.0, 5.0]},
        },
        "graphs": entries,
        "sampler": {
            "kind": "ode",
            "method": "rk4",
            "schedule": [0.0, 0.5, 1.0],
            "prior": {"mean": "route_states", "basis": "prior_basis"},
        },
        "finish": {
            "kind": "spline",
            "smooth": True,
            "project": False,
            "safety_margin": 0.05,
            "guidance": 0.0,
            "steps": 2,
            "num_control_points": 12,
            "degree": 4,
        },
        "time": {"steps": T, "first_s": 0.0, "dt": 7.0 / (T - 1)},
        "answer": {
            "components": ["x", "y"],
            "arrays": ["velocities", "accelerations", "scores", "clearance", "safe"],
        },
    }
    (folder / "manifest.json").write_text(json.dumps(manifest, indent=2))


@pytest.fixture(scope="session")
def _tiny_bundle_built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tiny-bundle")
    _write_bundle(folder)
    return folder


@pytest.fixture
def tiny_bundle(_tiny_bundle_built: Path, tmp_path: Path) -> Path:
    """A bundle's folder of one's own, to break."""
    return Path(shutil.copytree(_tiny_bundle_built, tmp_path / "bundle"))


@pytest.fixture
def edit_manifest(tiny_bundle: Path) -> Callable[..., None]:
    """Sets what lies at a path of keys in the tiny bundle's manifest."""
    return partial(_edit_manifest, tiny_bundle)


def _edit_manifest(folder: Path, *path: str | int, to: Any) -> None:
    file = folder / "manifest.json"
    manifest = json.loads(file.read_text())
    place = manifest
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = to
    file.write_text(json.dumps(manifest))


FREE_RANGES = {
    "robot_radius": [0.1, 0.6],
    "v_max": [0.2, 6.0],
    "a_max": [0.1, 8.0],
    "horizon_s": [1.0, 120.0],
}


@pytest.fixture(scope="session")
def free_bundle_built(_tiny_bundle_built: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tiny bundle, whose anchors now have their own durations, for robots of other limits."""
    folder = tmp_path_factory.mktemp("free") / "bundle"
    shutil.copytree(_tiny_bundle_built, folder)
    _edit_manifest(folder, "conditioning", "limits", "horizon_s", to=None)
    _edit_manifest(folder, "conditioning", "ranges", to=FREE_RANGES)
    _edit_manifest(folder, "time", "dt", to=None)
    return folder


@pytest.fixture
def turning_bundle(free_bundle_built: Path, tmp_path: Path) -> Path:
    """The same for poses with a heading."""
    folder = Path(shutil.copytree(free_bundle_built, tmp_path / "turning"))
    _edit_manifest(folder, "graphs", to=write_graphs(folder, _graphs_with_heading()))
    _edit_manifest(folder, "answer", "components", to=["x", "y", "heading"])
    # A heading has no obstacle to follow: eight samples say too little of twelve points of it.
    _edit_manifest(folder, "finish", "num_control_points", to=8)
    _edit_manifest(folder, "request", "inputs", 1, "shape", to=["B", 9])
    return folder


@pytest.fixture
def free_bundle(free_bundle_built: Path, tiny_bundle: Path) -> Path:
    """The same in place of `tiny_bundle`, to break with `edit_manifest`."""
    shutil.copy(free_bundle_built / "manifest.json", tiny_bundle)
    return tiny_bundle


@pytest.fixture
def small_request() -> Callable[..., AnchorRequest]:
    """A request on a 16×16 map of 8 m with an obstacle in its middle; any field can be changed."""

    def build(**changes: Any) -> AnchorRequest:
        occupancy = np.zeros((1, 16, 16), np.float32)
        occupancy[0, 7:9, 7:9] = 1.0
        fields = {
            "cost_map": {"data": occupancy, "resolution": 0.5},
            "x_curr": [-3.0, 0.1, 0.5, 0.0, 0.0, 0.0],
            "x_goal": [3.0, 0.2, 0.0, 0.0],
            "num_samples": 20,
            "seed": 7,
        }
        return AnchorRequest.build(**(fields | changes))

    return build


CARD = ModelCard(
    name="lines",
    version="1.2.3",
    sha256="ab" * 32,
    planner="lines",
    inputs=(TensorSpec("x_curr", "float32", ("B", 6), "m, m/s, m/s^2"),),
    conditioning=CostMapSpec(
        channels=3,
        H=64,
        W=64,
        limits=LimitsSpec(horizon_s=8.0, v_max=2.0, a_max=3.0, robot_radius=0.25),
        ranges={"robot_radius": (0.0, 5.0)},
    ),
    sampler=OdeSpec("rk4", (0.0, 0.5, 1.0)),
    finish=RefineSpec(smooth=True, project=True, safety_margin=0.05, guidance=0.0),
    time=TimeSpec(steps=16, first_s=0.0, dt=8.0 / 15),
    answer=AnswerSpec(("x", "y"), ("velocities", "accelerations", "scores", "clearance", "safe")),
)


FREE_CARD = replace(
    CARD,
    conditioning=replace(
        CARD.cost_map,
        limits=replace(CARD.cost_map.limits, horizon_s=None),
        ranges={"v_max": (0.1, 6.0), "horizon_s": (1.0, 60.0)},
    ),
    time=TimeSpec(steps=16, first_s=0.0, dt=None),
)
"""Of a planner whose anchors have their own durations."""


def minimum_jerk(steps: int) -> np.ndarray:
    """Position, velocity and acceleration [3,steps] from rest at 0 to rest at 1 in unit time."""
    s = np.linspace(0, 1, steps)
    position = 10 * s**3 - 15 * s**4 + 6 * s**5
    return np.stack([position, 30 * (s - s**2) ** 2, 60 * s - 180 * s**2 + 120 * s**3])


class StraightLines:
    """An engine: minimum-jerk motion along straight lines, fanned out by a seeded draw.

    `before_answer` sees each request and what would be answered, and gives what is answered: here
    a test lets the engine block, fail or answer nonsense.
    """

    def __init__(self, card: ModelCard = CARD) -> None:
        self.card = card
        self.seen: list[AnchorRequest] = []
        self.before_answer: Callable[[AnchorBatch], AnchorBatch] = lambda batch: batch

    def plan(self, request: AnchorRequest, /, **_: Any) -> AnchorBatch:
        """[B,N,T,2], the B axis dropped where the request is not batched."""
        self.seen.append(request)
        profile = minimum_jerk(self.card.T)
        scenes = [self._scene(request, b, profile) for b in range(request.num_scenes)]
        arrays: dict[str, Any] = {
            name: np.stack([scene[name] for scene in scenes]) for name in scenes[0]
        }
        if not request.batched:
            arrays = {name: array[0] for name, array in arrays.items()}
        return self.before_answer(
            AnchorBatch(
                arrays=arrays,
                dt=_time_steps(request, arrays["scores"].shape, self.card.T),
                seed=request.seed or 0,
                model=self.card.id,
                timing_ms={"encode": 1.0, "sample": 2.0, "refine": 3.0, "total": 6.0},
            )
        )

    def _scene(self, request: AnchorRequest, scene: int, profile: np.ndarray) -> dict[str, Any]:
        start, goal = request.x_curr[scene, :2], request.x_goal[scene, :2]
        fan = (
            np.random.default_rng(request.seed).normal(size=(request.num_samples or 64, 1, 1))
            * 0.01
        )
        line = profile[:, None, :, None] * (goal - start) + fan * profile[:, None, :, None]
        line[0] += start
        names = ("trajectories", "velocities", "accelerations")
        per_anchor = np.abs(fan[:, 0, 0])
        return dict(zip(names, line, strict=True)) | {
            "scores": -per_anchor,
            "clearance": per_anchor,
            "safe": per_anchor < 1,
        }


def _time_steps(request: AnchorRequest, anchors: tuple[int, ...], steps: int) -> Any:
    """The horizon's where there is one, else another for every anchor: 1 s, 1.1 s, 1.2 s …"""
    assert isinstance(request, ResolvedRequest)
    assert request.limits is not None
    horizon_s = request.limits.horizon_s
    if horizon_s is not None:
        return horizon_s / (steps - 1)
    return (1.0 + 0.1 * np.arange(np.prod(anchors)).reshape(anchors)) / (steps - 1)


@pytest.fixture
def free_engine() -> StraightLines:
    """A model whose anchors have their own durations."""
    return StraightLines(FREE_CARD)


@pytest.fixture
def engine() -> StraightLines:
    """The default model of `planning`."""
    return StraightLines()


@pytest.fixture
def planning(engine: StraightLines) -> PlanningService:
    """A service, not yet open, over that engine and a second model; it plans one at a time."""
    fixed = replace(CARD.cost_map, ranges={})
    second = StraightLines(replace(CARD, name="bows", conditioning=fixed))
    engines = {"lines": engine, "bows": second}
    return PlanningService(engines, default="lines", limits=ServiceLimits(threads=1))


@pytest.fixture
def fields() -> dict[str, Any]:
    """A good request over a free map of 16 x 20 cells, 0.5 m each."""
    return {
        "cost_map": {"data": np.zeros((1, 16, 20)).tolist(), "resolution": 0.5},
        "x_curr": [-3.0, 0.5, 0.0, 0.0, 0.0, 0.0],
        "x_goal": [3.0, 0.5, 0.0, 0.0],
        "num_samples": 4,
        "seed": 1,
    }


class Gate:
    """Holds an engine's answers back until it is opened."""

    def __init__(self) -> None:
        self.reached = threading.Event()
        self.opened = threading.Event()

    def __call__(self, batch: AnchorBatch) -> AnchorBatch:
        self.reached.set()
        assert self.opened.wait(20)
        return batch


@pytest.fixture
def gate(engine: StraightLines) -> Iterator[Gate]:
    """Stands before every answer of the default model of `planning`."""
    engine.before_answer = gate = Gate()
    yield gate
    gate.opened.set()


@pytest.fixture
def background() -> Iterator[ThreadPoolExecutor]:
    """For a request that is not waited for at once."""
    with ThreadPoolExecutor(2) as executor:
        yield executor


@pytest.fixture(scope="session")
def _image_bundle_built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_image_bundle(tmp_path_factory.mktemp("image-bundle"))


@pytest.fixture
def image_bundle(_image_bundle_built: Path, tmp_path: Path) -> Path:
    """The bundle of image_planner.py: a camera and the ego's status in, six trajectories out."""
    return Path(shutil.copytree(_image_bundle_built, tmp_path / "image-bundle"))
