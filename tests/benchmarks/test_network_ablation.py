"""Equal descents on a bundle's anchors and on splines along routes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from anchorflow_benchmarks import BenchmarkError
from anchorflow_benchmarks.baselines import DESCENTS, RoutesPlanner
from anchorflow_benchmarks.network_ablation import (
    BUNDLE_DESCENTS,
    Contender,
    ablation_tables,
    contenders,
    descending,
)
from anchorflow_benchmarks.planners import limits_of
from anchorflow_client.contract import NoFinish
from anchorflow_client.contract.fields import STYLES
from anchorflow_service.bundle import DEFAULT_BUNDLE, Bundle, load_bundle
from anchorflow_service.bundle.entries import SplineEntry
from anchorflow_training.scenes import FamilyScene
from anchorflow_trajectory.motion import MotionLimits

SceneMaker = Callable[..., FamilyScene]


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    return load_bundle(DEFAULT_BUNDLE)


@pytest.fixture
def case(scene: SceneMaker) -> FamilyScene:
    """A block a little above the straight way, so that there are two ways past it."""
    occupied = np.zeros((64, 64), bool)
    occupied[30:36, 29:35] = True
    return scene(occupied)


def rival(bundle: Bundle, descents: int) -> Contender:
    finish = bundle.manifest.finish
    assert isinstance(finish, SplineEntry)
    return Contender("routes", descents, RoutesPlanner(limits_of(bundle), finish, descents))


@pytest.mark.parametrize("descents", DESCENTS)
def test_a_finish_descends_as_often_as_it_is_told(bundle: Bundle, descents: int) -> None:
    changed = descending(bundle, descents)
    finish = changed.manifest.finish

    assert isinstance(finish, SplineEntry)
    assert (finish.smooth, finish.project) == (True, descents > 0)
    assert changed.card.finish == changed.manifest.card(sha256="").finish
    assert not descents or finish.steps == descents
    assert load_bundle(DEFAULT_BUNDLE).manifest == bundle.manifest


def test_routes_are_given_to_both_sides_and_last_as_long_as_they_need(
    bundle: Bundle, case: FamilyScene
) -> None:
    anchors = rival(bundle, 5).planner.plan(case, num=12, seed=1)
    beside = anchors.positions[:, 32, 1]

    assert (beside > 0.5).any()
    assert (beside < -0.2).any()
    assert len(np.unique(anchors.durations)) == 12
    assert (anchors.durations > case.motion.least_time(4.0)).all()


def test_a_table_a_style_and_a_row_a_contender(
    bundle: Bundle, case: FamilyScene, limits: MotionLimits
) -> None:
    ours = contenders([bundle], sampler="euler:uniform1", threads=1)
    assert [one.descents for one in ours] == [*BUNDLE_DESCENTS, *DESCENTS]
    few = [one for one in ours if one.descents in (5, 20)]
    done: list[int] = []
    tables = ablation_tables(few, [case], limits=limits, num=6, progress=done.append)

    assert [table.title for table in tables] == list(STYLES)
    assert sum(done) == len(STYLES)
    for table in tables:
        rows = [(row["source"], row["descents"]) for row in table.rows]
        name = bundle.card.name
        assert rows == [(name, 5), (name, 20), ("routes", 5), ("routes", 20)]
        for row in table.rows:
            assert 0.0 < float(row["best J"] or 0.0) <= float(row["J"] or 0.0)
            assert float(row["ms"] or 0.0) > 0.0


def test_costs_are_compared_where_everybody_succeeds(
    bundle: Bundle, scene: SceneMaker, case: FamilyScene, limits: MotionLimits
) -> None:
    blocked = np.zeros((64, 64), bool)
    blocked[:, 31:33] = True
    tables = ablation_tables([rival(bundle, 5)], [case, scene(blocked)], limits=limits, num=4)

    assert all("1 of 2 scenes" in table.note for table in tables)
    assert tables[0].rows[0]["success"] == pytest.approx(0.5)


def test_a_bundle_without_splines_has_no_descents(bundle: Bundle) -> None:
    manifest = bundle.manifest.model_copy(update={"finish": NoFinish()})
    with pytest.raises(BenchmarkError, match="expected a bundle whose finish is a spline"):
        descending(replace(bundle, manifest=manifest), 5)
