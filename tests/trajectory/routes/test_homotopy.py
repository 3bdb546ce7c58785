"""Rays: one for each obstacle that can be gone round, and which paths cross them."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import label

from anchorflow_trajectory.routes.homotopy import ObstacleRays


@given(seed=st.integers(0, 2**32 - 1), share=st.sampled_from((0.05, 0.2, 0.4)))
def test_obstacles_are_the_connected_parts_that_touch_no_edge(seed: int, share: float) -> None:
    blocked = np.random.default_rng(seed).random((20, 30)) < share
    labels = np.asarray(label(blocked, np.ones((3, 3)))[0])  # pyright: ignore[reportIndexIssue]
    outer = {0, *labels[0], *labels[-1], *labels[:, 0], *labels[:, -1]}
    numbers, first = np.unique(labels, return_index=True)
    cells = [cell for number, cell in zip(numbers, first, strict=True) if number not in outer]

    rays = ObstacleRays.of(np.where(blocked, -1.0, 1.0))
    assert (rays.rows * 30 + rays.columns).tolist() == cells
    assert rays.shape == (20, 30)


def test_a_path_crosses_the_rays_above_which_it_passes() -> None:
    clearance = np.ones((9, 9))
    clearance[2, 2] = clearance[4, 6] = -1.0
    above = np.array([[0.5, 5.5], [8.5, 5.5]])
    between = np.array([[0.5, 3.5], [4.5, 3.5], [4.5, 2.5], [8.5, 2.5]])
    twice = np.array([[2.5, 5.5], [3.5, 5.5], [3.5, 1.5], [1.5, 1.5], [1.5, 5.5], [3.5, 5.5]])

    def signature(path: np.ndarray) -> tuple[int, ...]:
        origin = np.array([10.0, -20.0])
        (found,) = ObstacleRays.of(clearance).signatures(
            path[None] * 0.5 + origin, resolution=0.5, origin=origin
        )
        return found

    assert signature(above) == (1, 1)
    assert signature(above[::-1]) == (-1, -1)
    assert signature(between) == (1, 0)
    assert signature(twice) == (2, 0)
