"""Simulated pictures, where OpenGL draws without a screen."""

from __future__ import annotations

import resource
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest


@pytest.fixture(scope="module")
def renderer() -> Any:
    pytest.importorskip("moderngl", reason="moderngl is not installed")
    from anchorflow_driving.sensors.rendering import Renderer, RenderingUnavailable

    try:
        return Renderer()
    except RenderingUnavailable as error:
        pytest.skip(f"EGL is not available: {error}")


def test_a_point_is_drawn_where_a_pinhole_sees_it(
    renderer: Any, on_street: Callable, other: type
) -> None:
    from anchorflow_driving.sensors.pinhole import PinholeCamera

    camera = PinholeCamera((0.0, 0.0, 1.0), 0.0, 0.0, focal=200.0, rows=200, columns=400)
    far, near = on_street(), on_street(other(28.0, 4.0, size=(4.0, 2.0)))

    changed = (renderer.draw(far.view, camera) != renderer.draw(near.view, camera)).any(-1)

    rows, columns = np.nonzero(changed)
    face = 28.0 + 0.2823 * 5.0 - 2.0  # m before the camera
    # Its left edge is its near left side; its right edge the near right side, nearer the middle.
    assert columns.min() == pytest.approx(200 - 200 * 5.0 / face, abs=1.5)
    assert columns.max() + 1 == pytest.approx(200 - 200 * 3.0 / (face + 4.0), abs=1.5)
    assert rows.max() + 1 == pytest.approx(100 + 200 * (1.0 - 0.25) / face, abs=3.0)


def test_the_stitched_picture_shows_who_is_where(
    renderer: Any, on_street: Callable, other: type
) -> None:
    from anchorflow_driving.sensors.cameras import simulated_camera

    empty = simulated_camera(on_street().view, renderer).astype(int)
    assert empty.shape == (3, 256, 1024)

    def columns_changed(x: float, y: float) -> np.ndarray:
        seen = simulated_camera(on_street(other(x, y, size=(2.0, 2.0))).view, renderer)
        return np.flatnonzero((seen != empty).any((0, 1)))

    ahead, left, right = columns_changed(15, 0), columns_changed(8, 14), columns_changed(8, -14)
    assert ahead.min() > 272
    assert ahead.max() < 752
    assert np.mean([ahead.min(), ahead.max()]) == pytest.approx(511.5, abs=1.0)
    assert left.max() < 272
    assert right.min() > 752
    np.testing.assert_array_equal(1023 - left[::-1], right)


def test_the_roadside_camera_sees_the_ego(renderer: Any, on_street: Callable) -> None:
    from anchorflow_driving.sensors.cameras import roadside_camera, simulated_roadside

    view = on_street().view
    seen = simulated_roadside(view, renderer)

    assert seen.shape == (270, 480, 3)
    assert (seen != renderer.draw(view, roadside_camera(view))).any()


def test_a_picture_is_drawn_again_alike(renderer: Any, on_street: Callable, other: type) -> None:
    from anchorflow_driving.sensors.cameras import simulated_camera

    first, second = (on_street(other(x, 4.0)).view for x in (10.0, 20.0))
    drawn = simulated_camera(first, renderer)
    simulated_camera(second, renderer)

    np.testing.assert_array_equal(simulated_camera(first, renderer), drawn)


def test_two_renderers_in_a_process_do_not_touch_one_another(
    renderer: Any, on_street: Callable, other: type
) -> None:
    from anchorflow_driving.sensors.cameras import simulated_camera

    view = on_street(other(12.0, 0.0)).view
    alone = simulated_camera(view, renderer)
    second = type(renderer)()  # whose context is now the current one
    np.testing.assert_array_equal(simulated_camera(view, renderer), alone)
    np.testing.assert_array_equal(simulated_camera(view, second), alone)


def test_the_pictures_of_roads_that_are_forgotten_take_no_memory(
    renderer: Any, on_street: Callable
) -> None:
    from anchorflow_driving.sensors.cameras import simulated_camera

    def megabytes() -> float:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return pages * resource.getpagesize() / 1e6

    def draw(roads: int) -> float:
        for _ in range(roads):
            simulated_camera(on_street().view, renderer)  # 9 MB each
        return megabytes()

    before = draw(4)
    assert draw(20) - before < 90
