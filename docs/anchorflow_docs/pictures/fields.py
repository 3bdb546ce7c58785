"""What the service works out of a map before it asks the network."""

from __future__ import annotations

from itertools import cycle
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from anchorflow_docs.pictures.marks import Array, draw_ends, draw_field, draw_map
from anchorflow_docs.pictures.overview import draw_answer
from anchorflow_docs.pictures.scenes import Stage
from anchorflow_docs.pictures.theme import WIDTH, Drawing, Theme
from anchorflow_trajectory.cost.fields import soft_cost
from anchorflow_trajectory.drawing import draw_paths
from anchorflow_trajectory.scene import Scene

FAMILY, WAYS = "rooms", 2
DOT_EVERY = 7
"""Time steps, from one dot on a spline to the next."""


def fields(stage: Stage) -> Drawing:
    """Occupancy, soft costs, clearance, the routes, the splines along them, and the answer."""
    scene = stage.scene_with_ways(FAMILY, WAYS, lambda scene: bool(soft_cost(scene.cost_map).any()))
    answer = stage.plan(scene)

    def draw(theme: Theme) -> Figure:
        figure, axes = plt.subplots(2, 3, figsize=(WIDTH, 5.9), layout="constrained")
        draw_map(axes[0, 0], scene, theme)
        draw_ends(axes[0, 0], scene, theme)
        soft = draw_field(
            axes[0, 1], scene, soft_cost(scene.cost_map), cmap=theme.costs, vmin=0, vmax=1
        )
        _draw_clearance(axes[0, 2], scene, theme)
        draw_routes(axes[1, 0], scene, theme)
        draw_route_splines(axes[1, 1], scene, theme)
        draw_answer(axes[1, 2], scene, answer, theme)
        titles = (
            "occupancy",
            "risk, hard ground",
            "clearance [m]",
            "routes",
            "splines along them",
            "anchors",
        )
        for axis, title in zip(axes.flat, titles, strict=True):
            axis.set_title(title)
        _bar(axes[0, 1], soft)
        return figure

    return draw


def draw_routes(axis: Axes, scene: Scene, theme: Theme) -> None:
    """The shortest way round the obstacles on each side, as the search finds and tightens it."""
    draw_map(axis, scene, theme)
    for route, colour in zip(scene.routes, cycle(theme.ways), strict=False):
        draw_paths(axis, route.points[None], colour, linewidths=1.4)
    draw_ends(axis, scene, theme)


def draw_route_splines(axis: Axes, scene: Scene, theme: Theme) -> None:
    """Where anchors begin: a spline along each route, with a dot at equal shares of its time."""
    draw_map(axis, scene, theme)
    for states, colour in zip(scene.route_states, cycle(theme.ways), strict=False):
        draw_paths(axis, states[None, :, :2], colour, linewidths=1.4)
        axis.plot(*states[::DOT_EVERY, :2].T, ".", color=colour, markersize=3.5)
    draw_ends(axis, scene, theme)


def _draw_clearance(axis: Axes, scene: Scene, theme: Theme) -> None:
    """Blue where there is room, red where the robot's disc would touch, and where it just does."""
    most = float(np.abs(scene.clearance_field).max())
    image = draw_field(axis, scene, scene.clearance_field, cmap=theme.room, vmin=-most, vmax=most)
    axis.contour(
        *_centres(scene), scene.clearance_field, levels=[0.0], colors=theme.ink, linewidths=1.0
    )
    _bar(axis, image)


def _centres(scene: Scene) -> tuple[Array, Array]:
    """x [W] and y [H] of the cells' centres, in m."""
    height, width = scene.occupied.shape
    x, y = (
        origin + (np.arange(count) + 0.5) * scene.resolution
        for origin, count in zip(scene.origin, (width, height), strict=True)
    )
    return x, y


def _bar(axis: Axes, image: Any) -> None:
    bar = axis.figure.colorbar(image, ax=axis, shrink=0.75, pad=0.02, aspect=30)
    bar.outline.set_visible(False)
    bar.ax.tick_params(length=0, labelsize=8)
