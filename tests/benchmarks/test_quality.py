"""Verdicts as tables, styles, and requests of other robots."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from anchorflow_benchmarks import BenchmarkError
from anchorflow_benchmarks.planners import Proposals, engine_planners, sampler_name
from anchorflow_benchmarks.quality import (
    RequestedRobot,
    judge_planners,
    quality_tables,
    style_tables,
)
from anchorflow_client.contract.fields import STYLES
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_training.scenes import FamilyScene
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.scene import Scene
from anchorflow_trajectory.spline.basis import spline_basis

SceneMaker = Callable[..., FamilyScene]


@dataclass
class Bows:
    """Bows to one side by the safety weight in m, is faster for energy, and claims to be safe."""

    name: str = "bows"
    evaluations: int | None = 3
    asked: list[tuple[str, int, int]] = field(default_factory=list)
    log: list[str] = field(default_factory=list)

    def plan(self, scene: Scene, *, num: int, seed: int) -> Proposals:
        assert isinstance(scene, FamilyScene)
        self.asked.append((scene.family, num, seed))
        self.log.append(self.name)
        basis = spline_basis(64)
        safety, energy, _ = (float(weight) for weight in scene.effective_style)
        splines = basis.rest_curves(scene.ends, np.full(num, 8.0 - 4.0 * energy))
        side = splines.control[1, :, basis.free]
        side += safety * np.sin(np.linspace(0.0, np.pi, side.shape[1]))
        return Proposals.of_spline(basis, splines, safe=np.ones(num, bool))


@pytest.fixture
def scenes(scene: SceneMaker) -> list[FamilyScene]:
    """One that can be crossed past a post below the way, one that cannot."""
    blocked, aside = np.zeros((32, 32), bool), np.zeros((32, 32), bool)
    blocked[:, 16] = True
    aside[10, 16] = True
    return [scene(aside, family="open"), scene(blocked, family="wall")]


def test_planners_take_turns_with_the_same_seed(
    scenes: list[FamilyScene], limits: MotionLimits
) -> None:
    log: list[str] = []
    one, other = Bows("one", log=log), Bows("other", log=log)
    judge_planners([one, other], scenes, limits=limits, num=4)

    assert log == ["one", "other"] + 2 * ["one", "other"]  # the first round is not counted
    assert one.asked == other.asked
    assert len({seed for *_, seed in one.asked}) == 1


def test_a_sampler_that_is_named_twice_is_one_planner() -> None:
    bundle = load_bundle(DEFAULT_BUNDLE)
    own = sampler_name(bundle.card.ode)
    planners = engine_planners([bundle], ["card", own, "euler:uniform1"], threads=1)

    assert [planner.name.split()[-1] for planner in planners] == [own, "euler:uniform1"]


def test_a_table_over_all_and_one_for_each_family(
    scenes: list[FamilyScene], limits: MotionLimits
) -> None:
    planner = Bows()
    plans = judge_planners([planner], scenes, limits=limits, num=4)
    every, free, wall = quality_tables([planner], plans)

    assert [t.title for t in (every, free, wall)] == [
        "All scenes (2)",
        "Family open (1)",
        "Family wall (1)",
    ]
    assert every.rows[0]["success"] == 0.5
    assert every.rows[0]["any"] == 0.5
    assert free.rows[0]["success"] == 1.0
    assert every.rows[0]["length"] == free.rows[0]["length"]  # of the scenes that have a success
    assert every.rows[0]["unsafe_called_safe"] == 4  # a count, not a mean
    assert every.rows[0]["duplicates"] == 1.0
    assert every.rows[0]["evaluations"] == 3
    assert wall.rows[0]["length"] != wall.rows[0]["length"]  # NaN


def test_numbers_that_are_not_finite_are_refused(
    scenes: list[FamilyScene], limits: MotionLimits
) -> None:
    class Broken(Bows):
        def plan(self, scene: Scene, *, num: int, seed: int) -> Proposals:
            anchors = super().plan(scene, num=num, seed=seed)
            return replace(anchors, velocities=anchors.velocities * np.nan)

    with pytest.raises(BenchmarkError, match=r"bows: .* not finite"):
        judge_planners([Broken()], scenes, limits=limits, num=2)


def test_a_row_a_style_and_what_the_names_promise(
    scenes: list[FamilyScene], limits: MotionLimits
) -> None:
    rows, ratios = style_tables([Bows()], scenes, limits=limits, num=3)

    assert [row["style"] for row in rows.rows] == list(STYLES)
    assert {row["scenes"] for row in rows.rows} == {1}  # the wall is never passed
    assert {row["success"] for row in rows.rows} == {0.5}
    durations = {str(row["style"]): row["duration"] for row in rows.rows}
    assert durations == pytest.approx(
        {"conservative": 7.989, "balanced": 6.8, "efficient": 4.875, "comfortable": 7.8}, abs=1e-3
    )
    (row,) = ratios.rows
    assert row["duration, efficient / conservative"] == pytest.approx(4.875 / 7.989, abs=1e-3)
    assert float(row["peak, efficient / conservative"] or 0.0) > 1.3
    assert float(row["clear, conservative / efficient"] or 0.0) > 1.25
    assert float(row["jerk, comfortable / efficient"] or 9.0) < 0.35  # by the third power of time


def test_without_a_scene_that_all_styles_solve_there_are_no_figures(
    scenes: list[FamilyScene], limits: MotionLimits
) -> None:
    rows, ratios = style_tables([Bows()], scenes[1:], limits=limits, num=2)

    assert all(np.isnan(float(row["duration"] or 0.0)) for row in rows.rows)
    assert ratios.rows[0]["scenes"] == 0


def test_a_slower_robot_starts_slower(scene: SceneMaker, limits: MotionLimits) -> None:
    moving = replace(
        scene(np.zeros((32, 32), bool)),
        x_curr=np.array([-2, 0, 1.0, 0.5, 0.6, 0.3], np.float32),
        x_goal=np.array([2, 0, 0.5, 0.0], np.float32),
    )
    slow = RequestedRobot(v_max=0.5, a_max=1.0, radius=0.4).scene(moving, limits)
    fast = RequestedRobot(v_max=5.0).scene(moving, limits)

    assert slow.x_curr == pytest.approx([-2, 0, 0.25, 0.125, 0.2, 0.1])
    assert slow.x_goal == pytest.approx([2, 0, 0.125, 0.0])
    assert (slow.robot_radius, fast.robot_radius) == (0.4, 0.25)
    assert fast.x_curr == pytest.approx(moving.x_curr)
    assert RequestedRobot(v_max=5.0).limits(limits) == replace(limits, v_max=5.0)
