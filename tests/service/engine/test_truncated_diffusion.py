"""The truncated diffusion in the engine, against the planner of tests/planners/ done by hand."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diffusion_planner import KEEP, expected, write_diffusion_bundle

from anchorflow_client import AnchorBatch, AnchorRequest
from anchorflow_client.contract import resolve_for_card
from anchorflow_client.errors import Cancelled, InvalidRequest
from anchorflow_service.bundle import load_bundle
from anchorflow_service.engine import Engine

SPEED = 3.0
EXTRAS = ("coarse_scores", "sub_scores")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_diffusion_bundle(tmp_path_factory.mktemp("diffusion"))


@pytest.fixture(scope="module")
def engine(folder: Path) -> Engine:
    return Engine(load_bundle(folder), threads=2)


def plan(engine: Engine, check: Callable[[], object] = lambda: None, **asked: Any) -> AnchorBatch:
    status = np.array([SPEED, 0, 0, 0], np.float32)
    request = AnchorRequest.build(inputs={"ego_status": status}, **{"seed": 7, **asked})
    return engine.plan(resolve_for_card(request, engine.card), check=check)


@pytest.mark.parametrize("steps", [1, 2, 4])
def test_the_best_by_the_fine_scores_come_first(engine: Engine, steps: int) -> None:
    chosen: dict[str, Any] = {"sampler": {"schedule": {"uniform": steps}}} if steps != 2 else {}
    anchors = plan(engine, outputs=EXTRAS, **chosen)
    for name, array in expected(SPEED, seed=7, steps=steps).items():
        np.testing.assert_allclose(anchors.arrays[name], array, atol=1e-4, err_msg=name)
    assert (anchors.dt, anchors.first_s) == (0.5, 0.5)
    assert "bev_semantics" not in anchors.arrays


def test_fewer_anchors_are_the_best_of_all(engine: Engine) -> None:
    all_of_them, two = plan(engine), plan(engine, num_samples=2)
    assert len(all_of_them.trajectories) == KEEP
    np.testing.assert_array_equal(two.trajectories, all_of_them.trajectories[:2])


def test_what_belongs_to_the_scene_is_not_sorted(engine: Engine) -> None:
    anchors = plan(engine, outputs=["bev_semantics"])
    np.testing.assert_array_equal(anchors.arrays["bev_semantics"], np.full((1, 2, 2), SPEED))


def test_the_seed_alone_decides(engine: Engine, folder: Path) -> None:
    again = Engine(load_bundle(folder), threads=1)
    first, other = plan(engine), plan(engine, seed=8)
    assert first.trajectories.tobytes() == plan(again).trajectories.tobytes()
    assert not np.array_equal(first.trajectories, other.trajectories)


@pytest.mark.parametrize("after", [1, 2, 3, 4, 5])
def test_it_stops_between_any_two_steps(engine: Engine, after: int) -> None:
    calls = 0

    def check() -> None:
        nonlocal calls
        calls += 1
        if calls > after:
            raise Cancelled

    # Checks run before encode, after it, after each of two steps, after coarse.
    with pytest.raises(Cancelled) if after < 5 else nullcontext():
        plan(engine, check=check)
    assert calls == min(after + 1, 5)


@pytest.mark.parametrize(
    ("asked", "field", "said"),
    [
        ({"num_samples": KEEP + 1}, "num_samples", f"expected 1 to {KEEP}"),
        ({"sampler": {"method": "euler"}}, "sampler.method", "expected none"),
        ({"sampler": {"schedule": {"uniform": 3}}}, "sampler.schedule", "one of 1, 2, 4, got 3"),
        ({"sampler": {"schedule": [0, 0.4, 1]}}, "sampler.schedule", "got 2 steps at [0.0, 0.4"),
        ({"refine": {"smooth": True}}, "refine", "expected none"),
        ({"outputs": ["goals"]}, "outputs", "expected"),
        ({"warm_start": {"trajectory": [[0, 0], [1, 0]]}}, "warm_start", "expected none"),
    ],
)
def test_a_wrong_request_names_its_field(
    engine: Engine, asked: dict[str, Any], field: str, said: str
) -> None:
    with pytest.raises(InvalidRequest) as raised:
        plan(engine, **asked)
    assert raised.value.field == field
    assert said in str(raised.value)
