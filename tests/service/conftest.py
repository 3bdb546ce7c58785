"""Bundles in folders of one's own, and a service over engines that need none."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from image_planner import write_image_bundle
from straight_lines import CARD, FREE_CARD, SteppingEngine, StraightLines
from tiny_bundle import FREE_RANGES, write_graphs_of, write_tiny_bundle
from written_graphs import set_in_manifest

from anchorflow_client import AnchorBatch, AnchorRequest
from anchorflow_service.planning import Call, Observer, PlanningService, ServiceLimits


@pytest.fixture(scope="session")
def _tiny_bundle_built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tiny-bundle")
    write_tiny_bundle(folder)
    return folder


@pytest.fixture
def tiny_bundle(_tiny_bundle_built: Path, tmp_path: Path) -> Path:
    """A bundle's folder of one's own, to break."""
    return Path(shutil.copytree(_tiny_bundle_built, tmp_path / "bundle"))


@pytest.fixture
def edit_manifest(tiny_bundle: Path) -> Callable[..., None]:
    """Sets the value at a path of keys in the tiny bundle's manifest."""
    return partial(set_in_manifest, tiny_bundle)


@pytest.fixture(scope="session")
def free_bundle_built(_tiny_bundle_built: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tiny bundle, whose anchors now have their own durations, for robots of other limits."""
    folder = tmp_path_factory.mktemp("free") / "bundle"
    shutil.copytree(_tiny_bundle_built, folder)
    set_in_manifest(folder, "conditioning.limits.horizon_s", to=None)
    set_in_manifest(folder, "conditioning.ranges", to=FREE_RANGES)
    set_in_manifest(folder, "time.dt", to=None)
    return folder


@pytest.fixture
def turning_bundle(free_bundle_built: Path, tmp_path: Path) -> Path:
    """The same for poses with a heading."""
    folder = Path(shutil.copytree(free_bundle_built, tmp_path / "turning"))
    set_in_manifest(folder, "graphs", to=write_graphs_of(folder, heading=True))
    set_in_manifest(folder, "answer.components", to=["x", "y", "heading"])
    # A heading has no obstacle to follow: eight samples say too little of twelve points of it.
    set_in_manifest(folder, "finish.num_control_points", to=8)
    set_in_manifest(folder, "request.inputs.1.shape", to=["B", 9])
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


@pytest.fixture
def stepping(engine: StraightLines) -> SteppingEngine:
    """The default model's engine, step by step."""
    return SteppingEngine(engine)


class Outcomes(Observer):
    """Records the outcome of every call."""

    def __init__(self) -> None:
        self.seen: list[str] = []
        self.heard = threading.Event()

    def ended(self, call: Call, outcome: str) -> None:  # noqa: ARG002
        self.seen.append(outcome)
        self.heard.set()


@pytest.fixture
def outcomes(planning: PlanningService) -> Outcomes:
    """The outcomes of the calls of `planning`."""
    planning.watch(recorded := Outcomes())
    return recorded


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
