"""The pictures draw a scene's routes and the splines along them."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from anchorflow_docs.pictures.answers import styles, warm_start
from anchorflow_docs.pictures.scenes import Stage
from anchorflow_docs.pictures.stages import (
    STEPS,
    draw_route_splines,
    draw_routes,
    fields,
    pipeline,
)
from anchorflow_docs.pictures.theme import DARK, LIGHT
from anchorflow_service.engine import Engine
from anchorflow_training.scenes import FamilyScene


@pytest.fixture(scope="module")
def stage(default_engine: Engine) -> Stage:
    return Stage(default_engine, seed=3)


@pytest.fixture(scope="module")
def scene(stage: Stage) -> FamilyScene:
    """A scene with a choice of routes."""
    return stage.scene("posts", lambda scene: len(scene.routes) > 1)


@pytest.fixture
def axis() -> Axes:
    return Figure().add_subplot()


def drawn_paths(axis: Axes) -> list[np.ndarray]:
    lines = [one for one in axis.collections if isinstance(one, LineCollection)]
    return [np.asarray(path) for one in lines for path in one.get_segments()]


def test_scenes_are_those_of_the_cards_robot(stage: Stage, scene: FamilyScene) -> None:
    limits = stage.engine.card.cost_map.limits
    assert (scene.motion.v_max, scene.motion.a_max) == (limits.v_max, limits.a_max)
    assert scene.motion.horizon_s == limits.horizon_s


def test_every_route_is_drawn_from_start_to_goal(scene: FamilyScene, axis: Axes) -> None:
    draw_routes(axis, scene, LIGHT)

    paths = drawn_paths(axis)
    assert len(paths) == len(scene.routes)
    for path, route in zip(paths, scene.routes, strict=True):
        np.testing.assert_array_equal(path, route.points)


def test_every_routes_spline_is_drawn(scene: FamilyScene, axis: Axes) -> None:
    draw_route_splines(axis, scene, DARK)

    paths = drawn_paths(axis)
    assert len(paths) == len(scene.routes)
    np.testing.assert_array_equal(paths, scene.route_states[..., :2])


def test_pictures_of_what_an_answer_is_made_of_are_drawn(stage: Stage) -> None:
    titles = {}
    for picture in (fields, pipeline, styles, warm_start):
        with plt.rc_context(LIGHT.settings):
            figure = picture(stage)(LIGHT)
        figure.draw_without_rendering()
        titles[picture.__name__] = [axis.get_title() for axis in figure.axes]
        plt.close(figure)

    assert {"routes", "splines along them", "anchors"} <= set(titles["fields"])
    assert titles["pipeline"] == [*STEPS]
    assert titles["styles"][0] == "conservative: 0.7, 0.1, 0.2"
    assert titles["warm_start"][0] == "from noise"
