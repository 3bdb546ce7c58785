"""Outlines on a map: touched cells, growth, and points along the rim."""

from __future__ import annotations

import numpy as np
import pytest

from anchorflow_benchmarks.body_judge import BodyJudge
from anchorflow_trajectory.bodies.outline import Outline, covered, ground_of, touches

RESOLUTION = 0.1
SHAPES = {
    "rectangle": np.array([[-0.45, -0.31], [0.45, -0.31], [0.45, 0.31], [-0.45, 0.31]]),
    "off centre": np.array([[-0.55, -0.33], [0.15, -0.33], [0.15, 0.33], [-0.55, 0.33]]),
    "triangle": np.array([[-0.3, -0.4], [0.7, 0.0], [-0.3, 0.4]]),
}


def scattered(seed: int) -> np.ndarray:
    """[40, 40], one cell in thirty occupied."""
    return np.random.default_rng(seed).random((40, 40)) < 1 / 30


@pytest.mark.parametrize("shape", SHAPES)
def test_an_outline_touches_exactly_the_cells_that_it_meets(shape: str) -> None:
    occupied, rng = scattered(1), np.random.default_rng(2)
    ground = ground_of(occupied, RESOLUTION, np.array([-2.0, -2.0]))
    outline, spans = Outline(SHAPES[shape]), np.empty((2, 40))
    judge = BodyJudge(occupied, RESOLUTION, SHAPES[shape])
    poses = np.column_stack([rng.uniform(-2.1, 2.1, (400, 2)), rng.uniform(-4, 4, 400)])
    found = [touches(ground, outline.corners, outline.reach, pose, spans) for pose in poses]
    wanted = [judge.touches(np.stack([pose, pose])) for pose in poses]
    # Points two centimetres apart miss what an outline just touches, and never more.
    assert not any(w and not f for f, w in zip(found, wanted, strict=True))
    assert np.mean(np.array(found) != wanted) < 0.02
    assert 0.2 < np.mean(found) < 0.98


def test_a_grown_outline_lies_farther_out_all_round() -> None:
    for corners in SHAPES.values():
        outline = Outline(corners)
        grown = outline.grown(0.1)
        assert grown.inner == pytest.approx(outline.inner + 0.1)
        assert grown.reach >= outline.reach + 0.1


def test_the_polygon_about_a_disc_holds_it() -> None:
    assert Outline.disc(0.3).inner == pytest.approx(0.3)
    assert Outline.disc(0.3).reach < 0.31


def test_the_rim_has_the_corners_and_no_wide_gap() -> None:
    corners = SHAPES["triangle"]
    rim = Outline(corners).rim(0.12)
    assert all(np.isclose(rim, corner).all(1).any() for corner in corners)
    assert np.hypot(*np.diff(rim, axis=0, append=rim[:1]).T).max() <= 0.12 + 1e-9


def test_cells_under_an_outline_are_those_that_it_touches() -> None:
    outline, pose = Outline(SHAPES["off centre"]), np.array([0.13, -0.2, 0.7])
    origin = np.array([-2.0, -2.0])
    under = covered(outline, pose, resolution=RESOLUTION, origin=origin, shape=(40, 40))
    assert 30 < under.sum() < 120
    spans, cell = np.empty((2, 40)), np.zeros((40, 40), bool)
    for row, column in np.ndindex(40, 40):
        cell[:] = False
        cell[row, column] = True
        ground = ground_of(cell, RESOLUTION, origin)
        if touches(ground, outline.corners, outline.reach, pose, spans):
            assert under[row, column]
