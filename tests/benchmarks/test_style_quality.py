"""What a change of style changes, as tables."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from anchorflow_benchmarks.anchors import Proposals
from anchorflow_benchmarks.style_quality import style_tables
from anchorflow_client.contract.styles import STYLES
from anchorflow_training.scenes import FamilyScene
from anchorflow_trajectory.cost import MotionLimits
from anchorflow_trajectory.scene import Scene
from anchorflow_trajectory.spline import spline_basis

SceneMaker = Callable[..., FamilyScene]


@dataclass
class Styled:
    """One anchor from end to end; it bows to one side for safety and hurries for energy."""

    name: str = "styled"
    evaluations: None = None

    def plan(self, scene: Scene, *, num: int, seed: int) -> Proposals:  # noqa: ARG002
        safety, energy, _ = (float(weight) for weight in scene.w_style)
        basis = spline_basis(64)
        splines = basis.rest_curves(scene.ends, np.full(num, 8.0 - 4.0 * energy))
        side = splines.control[1, :, basis.free]
        side += safety * np.sin(np.linspace(0.0, np.pi, side.shape[1]))
        return Proposals.of_spline(basis, splines)


@pytest.fixture
def scenes(scene: SceneMaker) -> list[FamilyScene]:
    """One that can be crossed past a post below the way, one that cannot."""
    blocked, aside = np.zeros((32, 32), bool), np.zeros((32, 32), bool)
    blocked[:, 16] = True
    aside[10, 16] = True
    return [scene(aside), scene(blocked)]


def test_a_row_a_style_and_what_the_names_promise(
    scenes: list[FamilyScene], limits: MotionLimits
) -> None:
    rows, ratios = style_tables([Styled()], scenes, limits=limits, num=3)

    assert [row["style"] for row in rows.rows] == list(STYLES)
    assert {row["scenes"] for row in rows.rows} == {1}  # the wall is never passed
    assert {row["success"] for row in rows.rows} == {0.5}
    durations = {str(row["style"]): row["duration"] for row in rows.rows}
    assert durations == pytest.approx(
        {"conservative": 7.6, "balanced": 6.8, "efficient": 4.8, "comfortable": 7.6}, abs=1e-3
    )
    (row,) = ratios.rows
    assert row["duration, efficient / conservative"] == pytest.approx(4.8 / 7.6, abs=1e-3)
    assert float(row["peak, efficient / conservative"] or 0.0) > 1.3
    assert float(row["clear, conservative / efficient"] or 0.0) > 1.25
    assert float(row["jerk, comfortable / efficient"] or 9.0) < 0.3  # by the third power of time


def test_without_a_scene_that_all_styles_solve_there_are_no_figures(
    scenes: list[FamilyScene], limits: MotionLimits
) -> None:
    rows, ratios = style_tables([Styled()], scenes[1:], limits=limits, num=2)

    assert all(np.isnan(float(row["duration"] or 0.0)) for row in rows.rows)
    assert ratios.rows[0]["scenes"] == 0
