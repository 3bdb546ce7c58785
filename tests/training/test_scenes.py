"""Scenes are solvable problems: ends free and connected, within the limits, every family drawn."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
import pytest
from scipy.sparse.csgraph import dijkstra

from anchorflow_training.scene_layouts import LAYOUTS, Canvas
from anchorflow_training.scenes import FamilyScene, RobotRanges, SceneError, draw_scene, grid_graph
from anchorflow_trajectory.motion import MotionLimits


def test_steps_weigh_their_length_times_the_mean_cost() -> None:
    cost = np.array([[1.0, 3.0], [1.0, 5.0]])
    graph = grid_graph(cost, 0.5).toarray()
    weights = graph + graph.T
    assert weights[0, 1] == pytest.approx(0.5 * 2.0)
    assert weights[0, 2] == pytest.approx(0.5 * 1.0)
    assert weights[0, 3] == pytest.approx(0.5 * np.sqrt(2.0) * 3.0)
    assert weights[1, 2] == pytest.approx(0.5 * np.sqrt(2.0) * 2.0)
    assert np.count_nonzero(graph) == 6  # each pair of neighbours once


def test_open_ground_is_as_far_as_steps_to_eight_neighbours_lead() -> None:
    graph = grid_graph(np.ones((20, 30), np.float32), 0.1)
    far = dijkstra(graph, directed=False, indices=0).reshape(20, 30)
    assert far[0, 29] == pytest.approx(2.9, rel=1e-5)
    assert far[10, 10] == pytest.approx(np.sqrt(2.0), rel=1e-5)
    assert far[4, 9] == pytest.approx(0.5 + 0.4 * np.sqrt(2.0), rel=1e-5)


LIMITS = MotionLimits(v_max=2.0, a_max=3.0)
ROBOTS = RobotRanges()


def drawn(count: int) -> list[FamilyScene]:
    rng, scenes = np.random.default_rng(0), []
    while len(scenes) < count:
        with suppress(SceneError):
            scenes.append(draw_scene(rng, limits=LIMITS, robots=ROBOTS))
    return scenes


@pytest.fixture(scope="module")
def scenes() -> list[FamilyScene]:
    return drawn(60)


def test_both_ends_are_free_and_apart(scenes: list[FamilyScene]) -> None:
    for scene in scenes:
        for point in (scene.x_curr[:2], scene.x_goal[:2]):
            column, row = ((point - scene.origin) / scene.resolution).astype(int)
            assert scene.clearance_field[row, column] > 0
        assert np.linalg.norm(scene.x_goal[:2] - scene.x_curr[:2]) > 0.5


def test_speeds_and_styles_are_in_range(scenes: list[FamilyScene]) -> None:
    shares = np.array([np.linalg.norm(s.x_curr[2:4]) / s.motion.v_max for s in scenes])
    assert (shares <= 1.0).all()
    assert (shares == 0).any()
    assert (shares > 0.5).any()
    styles = np.array([s.w_style for s in scenes])
    np.testing.assert_allclose(styles.sum(1), 1.0, atol=1e-5)


def test_maps_differ_in_size_radius_and_family(scenes: list[FamilyScene]) -> None:
    sizes = np.array([s.resolution * s.cost_map.shape[-1] for s in scenes])
    assert sizes.min() < 7
    assert 14 < sizes.max() <= 60
    assert np.ptp([s.robot_radius for s in scenes]) > 0.2
    assert len({s.family for s in scenes}) >= 8


def test_robots_differ_within_their_ranges(scenes: list[FamilyScene]) -> None:
    """The usual one is drawn most, the others anywhere between."""
    motions = [scene.motion for scene in scenes]
    usual = [(m.v_max, m.a_max) == (LIMITS.v_max, LIMITS.a_max) for m in motions]
    assert 0.2 < np.mean(usual) < 0.6
    for name in ("v_max", "a_max"):
        least, most = getattr(ROBOTS, name)
        values = np.array([getattr(motion, name) for motion in motions])
        assert least <= values.min() < 0.5 * getattr(LIMITS, name)
        assert 1.5 * getattr(LIMITS, name) < values.max() <= most
    radii = np.array([scene.robot_radius for scene in scenes])
    assert ROBOTS.robot_radius[0] <= radii.min() < radii.max() <= ROBOTS.robot_radius[1]


def test_some_scenes_have_a_horizon_in_which_they_can_be_gone(scenes: list[FamilyScene]) -> None:
    fixed = [scene for scene in scenes if scene.motion.horizon_s is not None]
    assert 0.05 < len(fixed) / len(scenes) < 0.4
    for scene in fixed:
        assert scene.motion.horizon_s is not None
        assert ROBOTS.horizon_s[0] <= scene.motion.horizon_s <= ROBOTS.horizon_s[1]
        assert scene.motion.horizon_s > scene.reference_s
        assert scene.limits[3] == np.float32(scene.motion.horizon_s)


def test_no_scene_has_a_horizon_where_none_is_asked_for() -> None:
    rng, robots = np.random.default_rng(0), RobotRanges(usual=1.0, fixed=0.0)
    for _ in range(5):
        with suppress(SceneError):
            assert draw_scene(rng, limits=LIMITS, robots=robots).motion == LIMITS


@pytest.mark.parametrize("family", LAYOUTS)
def test_each_layout_leaves_ground_free(family: str) -> None:
    layout, share = LAYOUTS[family]
    assert share > 0
    covered = []
    for seed in range(6):
        filled = layout(Canvas(np.random.default_rng(seed), 96, 0.1, 0.25))
        assert filled.shape == (96, 96)
        assert filled.dtype == bool
        covered.append(filled.mean())
    assert min(covered) < 0.97
    assert family == "empty" or max(covered) > 0.01
