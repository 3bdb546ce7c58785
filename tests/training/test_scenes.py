"""Scenes are solvable problems: ends free and connected, within the limits, every family drawn."""

from contextlib import suppress

import numpy as np
import pytest

from anchorflow_training.scenes import FamilyScene, SceneError, draw_scene
from anchorflow_training.scenes.layouts import LAYOUTS, Canvas
from anchorflow_trajectory.cost import MotionLimits

LIMITS = MotionLimits(v_max=2.0, a_max=3.0, horizon_s=8.0)


def drawn(count: int) -> list[FamilyScene]:
    rng, scenes = np.random.default_rng(0), []
    while len(scenes) < count:
        with suppress(SceneError):
            scenes.append(draw_scene(rng, limits=LIMITS))
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
    speeds = np.array([np.linalg.norm(s.x_curr[2:4]) for s in scenes])
    assert (speeds <= LIMITS.v_max).all()
    assert (speeds == 0).any()
    assert (speeds > 0.5).any()
    styles = np.array([s.w_style for s in scenes])
    np.testing.assert_allclose(styles.sum(1), 1.0, atol=1e-5)


def test_maps_differ_in_size_radius_and_family(scenes: list[FamilyScene]) -> None:
    sizes = np.array([s.resolution * s.cost_map.shape[-1] for s in scenes])
    assert sizes.min() < 9
    assert sizes.max() > 13
    assert np.ptp([s.robot_radius for s in scenes]) > 0.2
    assert len({s.family for s in scenes}) >= 8


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


def test_the_same_seed_draws_the_same_scene() -> None:
    first, second = drawn(3), drawn(3)
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.cost_map, b.cost_map)
        np.testing.assert_array_equal(a.x_goal, b.x_goal)
