"""Soft costs are judged against the cheapest way, which goes round what is dear enough."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from anchorflow_benchmarks.baselines import RoutesPlanner, spline_finish
from anchorflow_benchmarks.grid_path import cheapest_way
from anchorflow_benchmarks.planners import limits_of, open_bundle
from anchorflow_benchmarks.scene_files import draw_scenes
from anchorflow_benchmarks.soft_costs import LAYOUTS, path_cost, soft_cost_row
from anchorflow_service.bundle import DEFAULT_BUNDLE
from anchorflow_training.scenes import FamilyScene
from anchorflow_trajectory.motion import MotionLimits

LIMITS = MotionLimits(v_max=2.0, a_max=3.0)


@pytest.fixture(scope="module")
def scene() -> FamilyScene:
    """Open ground of 9.6 m with a dear patch across the straight way."""
    (drawn,) = draw_scenes(1, 0, limits=LIMITS)
    layers = np.zeros((3, 96, 96), np.float32)
    layers[1], layers[2, 36:60, 36:60] = 1.0, 1.0
    return replace(
        drawn,
        cost_map=layers,
        resolution=0.1,
        origin=np.array([-4.8, -4.8]),
        x_curr=np.array([-4.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        x_goal=np.array([4.0, 0.0, 0.0, 0.0]),
        cost_penalty=4.0,
    )


def test_the_cheapest_way_goes_round_and_costs_its_length(scene: FamilyScene) -> None:
    way = cheapest_way(scene)
    length = np.hypot(*np.diff(way, axis=0).T).sum()

    assert not (np.abs(way) < 1.1).all(-1).any()
    assert path_cost(scene, way) == pytest.approx(length, rel=0.03)
    straight = np.array([[-4.0, 0.0], [4.0, 0.0]])
    assert path_cost(scene, straight) == pytest.approx(8.0 + 4.0 * 2.4, rel=0.01)
    assert path_cost(replace(scene, cost_penalty=0.0), straight) == pytest.approx(8.0)


def test_routes_and_a_finish_find_it(scene: FamilyScene) -> None:
    bundle = open_bundle(DEFAULT_BUNDLE)
    planner = RoutesPlanner(limits_of(bundle), spline_finish(bundle), 6)

    row = soft_cost_row(planner, [scene], num=8)

    assert row["any safe"] == row["moved"] == 1.0
    assert row["chosen"] == pytest.approx(1.0, abs=0.1)
    assert row["any"] == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_layouts_are_dear_on_free_ground_alone(layout: str) -> None:
    (drawn,) = draw_scenes(1, 3, limits=LIMITS)
    dear = LAYOUTS[layout](drawn, 0)

    assert 0.0 < dear.cost_map[2].max() <= 1.0
    assert not dear.cost_map[2][drawn.occupied].any()
    np.testing.assert_array_equal(dear.occupied, drawn.occupied)
