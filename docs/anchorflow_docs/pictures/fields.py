"""What the service works out of a map before it asks the network."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from anchorflow_docs.pictures.marks import Array, draw_ends, draw_field, draw_map
from anchorflow_docs.pictures.overview import draw_answer
from anchorflow_docs.pictures.scenes import Stage
from anchorflow_docs.pictures.theme import WIDTH, Drawing, Theme
from anchorflow_trajectory.cost_fields import soft_cost
from anchorflow_trajectory.scene import Scene

FAMILY, WAYS = "rooms", 2
LINE_EVERY_M = 1.0
"""From one line of equal cost to the next."""
FARTHEST_SHARE = 0.98
"""Of the cells, whose costs the colours span: some corners are far beyond."""


def fields(stage: Stage) -> Drawing:
    """Occupancy, soft costs, clearance, the geodesic cost from both ends, and the answer."""
    scene = stage.scene_with_ways(FAMILY, WAYS, lambda scene: bool(soft_cost(scene.cost_map).any()))
    from_start, to_goal = scene.cost_to_go
    answer = stage.plan(scene)

    def draw(theme: Theme) -> Figure:
        figure, axes = plt.subplots(2, 3, figsize=(WIDTH, 5.9), layout="constrained")
        draw_map(axes[0, 0], scene, theme)
        draw_ends(axes[0, 0], scene, theme)
        soft = draw_field(
            axes[0, 1], scene, soft_cost(scene.cost_map), cmap=theme.costs, vmin=0, vmax=1
        )
        _draw_clearance(axes[0, 2], scene, theme)
        for axis, costs in zip(axes[1], (from_start, to_goal), strict=False):
            draw_costs(axis, scene, costs, theme)
            draw_ends(axis, scene, theme)
        draw_answer(axes[1, 2], scene, answer, theme)
        titles = (
            "occupancy",
            "risk, hard ground",
            "clearance [m]",
            "cost from the start [m]",
            "cost to the goal [m]",
            "anchors",
        )
        for axis, title in zip(axes.flat, titles, strict=True):
            axis.set_title(title)
        _bar(axes[0, 1], soft)
        return figure

    return draw


def draw_costs(axis: Axes, scene: Scene, costs: Array, theme: Theme) -> None:
    """A geodesic cost [H,W] where the robot's centre may be, with lines of equal cost."""
    free = np.where(scene.clearance_field > 0, costs, np.nan)
    top = float(np.nanquantile(free, FARTHEST_SHARE))
    draw_map(axis, scene, theme)
    image = draw_field(axis, scene, free, cmap=theme.field, vmin=0.0, vmax=top)
    levels = np.arange(LINE_EVERY_M, top, LINE_EVERY_M)
    axis.contour(*_centres(scene), free, levels=levels, colors=theme.page, linewidths=0.6)
    _bar(axis, image)


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
