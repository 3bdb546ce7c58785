"""The benchmark of bodies: its judge, its rivals, and a family that a forklift fits through."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from anchorflow_benchmarks import bodies, options
from anchorflow_benchmarks.body_judge import BodyJudge, ahead, driven, sideways
from anchorflow_service.bundle import load_bundle
from anchorflow_service.engine import Engine


@pytest.fixture(scope="module")
def engine() -> Engine:
    return Engine(load_bundle(options.STUDENT), threads=2)


@pytest.mark.parametrize("family", bodies.FAMILIES)
def test_robots_start_and_end_where_they_fit(family: str) -> None:
    for seed in range(4):
        at = bodies.FAMILIES[family](np.random.default_rng(seed))
        judge = BodyJudge(at.occupied, bodies.RESOLUTION, at.footprint)
        assert not judge.touches(np.array([at.start, at.start]))
        assert not judge.touches(np.array([at.goal, at.goal]))


def test_a_footprint_does_what_its_discs_do_not(engine: Engine) -> None:
    aisles = [bodies.aisle(np.random.default_rng(seed)) for seed in range(2)]
    rows = {name: bodies.row_of(name, engine, aisles, 8) for name in bodies.PLANNERS}
    assert rows["poses"]["any"] == 1.0
    assert rows["poses"]["lies"] == 0
    success = rows["disc about it"]["success"]
    assert isinstance(success, float)
    assert success < 0.5


def test_a_way_of_ompl_ends_at_the_goal_in_the_gears_of_a_car(engine: Engine) -> None:
    pytest.importorskip("ompl")
    ends = (-2.0, 0.0, 0.0), (2.0, 1.0, 0.0)
    at = bodies.Situation(bodies.FREE, *ends, bodies.CAR, bodies.ACKERMANN)
    found = bodies.by_rrt(engine, at, 4, 0)
    assert found.safe.all()
    assert bodies.verdicts(found, at).all()
    assert bodies.replayed(found, at)
    shifted = found.trajectories + np.array([0.0, 0.3, 0.0])
    aside = replace(found, arrays=dict(found.arrays) | {"trajectories": shifted})
    assert not bodies.replayed(aside, at)


def test_the_judge_sees_walls_slips_and_where_a_bicycle_ends() -> None:
    times = np.linspace(0.0, 2.0, 50)
    path = np.stack([0.5 * times, 0.0 * times, 0.0 * times], 1)
    velocity = np.tile([0.5, 0.0, 0.0], (50, 1))
    wall = bodies.painted(True, (1.3, 1.5, -1, 1), on=bodies.FREE)
    assert not BodyJudge(bodies.FREE, 0.05, bodies.FORKLIFT).touches(path)
    assert BodyJudge(wall, 0.05, bodies.FORKLIFT).touches(path)
    assert not BodyJudge(wall, 0.05, bodies.FORKLIFT).touches(path[:30])
    judge, at = BodyJudge(bodies.FREE, 0.05, bodies.FORKLIFT), np.array([[2.0, 0.0]])
    comes, radii = np.stack([at, at - np.array([0.3, 0.0])], 1), np.array([0.3])
    # Its front is at 0.45 + 0.5 t, that of what comes at 1.7 - 0.3 t: they meet after 1.56 s.
    assert not judge.meets(path[:38], float(times[37]), comes, radii)
    assert judge.meets(path[:40], float(times[39]), comes, radii)
    assert sideways(path + np.array([0, 0, 0.5]), velocity).min() < -0.2
    np.testing.assert_allclose(ahead(path, velocity), 0.5)
    np.testing.assert_allclose(driven(path, velocity, 2.0), [1.0, 0.0, 0.0], atol=2e-3)
