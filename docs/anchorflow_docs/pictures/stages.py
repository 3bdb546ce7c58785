"""Pictures of the stages of a request: fields of the map, routes, noise, the flow, the finish."""

from __future__ import annotations

from itertools import cycle
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from anchorflow_docs.pictures.scenes import Stage
from anchorflow_docs.pictures.theme import (
    WIDTH,
    Array,
    Drawing,
    Theme,
    draw_answer,
    draw_ends,
    draw_field,
    draw_map,
)
from anchorflow_trajectory.drawing import draw_paths
from anchorflow_trajectory.scene import Scene

DOT_EVERY = 7  # time steps between dots on a spline
TIMES = (0.0, 0.5, 0.8, 1.0)  # of the flow
FLOW_STEPS = 10  # equal ones, which include TIMES
FOLLOWED = 3  # anchors in the last panel of the flow
STEPS = ("the request", "routes", "sample: noise …", "… carried to t = 1", "refine: the answer")


def pipeline(stage: Stage) -> Drawing:
    """Draw the stages of a request in five panels with arrows between them."""
    scene = stage.scene_with_ways("bug_traps", 2)
    states = stage.flow_states(scene).positions
    answer = stage.plan(scene)

    def draw(theme: Theme) -> Figure:
        figure, axes = plt.subplots(1, len(STEPS), figsize=(WIDTH, 2.05), layout="constrained")
        figure.get_layout_engine().set(wspace=0.12)  # type: ignore[union-attr]
        for axis in axes[[0, 2, 3]]:
            draw_map(axis, scene, theme)
        draw_route_splines(axes[1], scene, theme)
        for axis, paths in zip(axes[2:4], states[[0, -1]], strict=True):
            draw_paths(axis, paths, theme.ways[0], alpha=0.5, linewidths=0.7)
        draw_answer(axes[4], scene, answer, theme)
        for axis in axes[:4]:
            draw_ends(axis, scene, theme)
            _arrow(axis, theme)
        for axis, step in zip(axes, STEPS, strict=True):
            axis.set_title(step)
        return figure

    return draw


def _arrow(axis: Axes, theme: Theme) -> None:
    """Draw an arrow from a panel to the next one."""
    axis.annotate(
        "",
        xytext=(1.01, 0.5),
        xy=(1.15, 0.5),
        xycoords="axes fraction",
        annotation_clip=False,
        arrowprops={"arrowstyle": "-|>", "color": theme.ink, "linewidth": 1.4},
    )


def fields(stage: Stage) -> Drawing:
    """Draw occupancy, soft costs, clearance, the routes, their splines, and the answer."""
    scene = stage.scene_with_ways("rooms", 2, lambda scene: scene.surcharge is not None)
    answer, surcharge = stage.plan(scene), scene.surcharge
    assert surcharge is not None

    def draw(theme: Theme) -> Figure:
        figure, axes = plt.subplots(2, 3, figsize=(WIDTH, 5.9), layout="constrained")
        draw_map(axes[0, 0], scene, theme)
        draw_ends(axes[0, 0], scene, theme)
        soft = draw_field(
            axes[0, 1], scene, surcharge, cmap=theme.costs, vmin=0, vmax=scene.cost_penalty
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
    """Draw the shortest way round the obstacles on each side."""
    draw_map(axis, scene, theme)
    for route, colour in zip(scene.routes, cycle(theme.ways), strict=False):
        draw_paths(axis, route.points[None], colour, linewidths=1.4)
    draw_ends(axis, scene, theme)


def draw_route_splines(axis: Axes, scene: Scene, theme: Theme) -> None:
    """Draw the spline along each route, with dots at equal times."""
    draw_map(axis, scene, theme)
    for states, colour in zip(scene.route_states, cycle(theme.ways), strict=False):
        draw_paths(axis, states[None, :, :2], colour, linewidths=1.4)
        axis.plot(*states[::DOT_EVERY, :2].T, ".", color=colour, markersize=3.5)
    draw_ends(axis, scene, theme)


def _draw_clearance(axis: Axes, scene: Scene, theme: Theme) -> None:
    """Draw positive clearance blue, negative red, and the line between them."""
    most = float(np.abs(scene.clearance_field).max())
    image = draw_field(axis, scene, scene.clearance_field, cmap=theme.room, vmin=-most, vmax=most)
    axis.contour(
        *_centres(scene), scene.clearance_field, levels=[0.0], colors=theme.ink, linewidths=1.0
    )
    _bar(axis, image)


def _centres(scene: Scene) -> tuple[Array, Array]:
    """Return x [W] and y [H] of the cell centres in m."""
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


def flow(stage: Stage) -> Drawing:
    """Draw the same noise at five moments, and single anchors at all of them."""
    scene = stage.scene_with_ways("forest", 4)
    sampler = {"method": "rk4", "schedule": {"uniform": FLOW_STEPS}}
    states = stage.flow_states(scene, sampler=sampler)
    answer = stage.plan(scene, sampler=sampler)
    moments = [states.positions[np.abs(states.times - t).argmin()] for t in TIMES]
    moments.append(answer.trajectories)
    names = [f"t = {t:g}" for t in TIMES]
    names[0] += ", noise"
    names[-1] += ", the network's proposal"

    def draw(theme: Theme) -> Figure:
        figure, axes = plt.subplots(2, 3, figsize=(WIDTH, 6.6), layout="constrained")
        for axis, name, paths in zip(axes.flat, names, moments, strict=False):
            draw_map(axis, scene, theme)
            draw_paths(axis, paths, theme.ways[0], alpha=0.55)
            draw_ends(axis, scene, theme)
            axis.set_title(name)
        draw_answer(axes[1, 1], scene, answer, theme)
        axes[1, 1].set_title("finished")
        _draw_followed(axes[1, 2], scene, moments, theme)
        return figure

    return draw


def _draw_followed(axis: Axes, scene: Scene, moments: list[Array], theme: Theme) -> None:
    draw_map(axis, scene, theme)
    for n, colour in enumerate(theme.ways[:FOLLOWED]):
        for shade, paths in zip(np.linspace(0.2, 1.0, len(moments)), moments, strict=True):
            draw_paths(axis, paths[n : n + 1], colour, alpha=shade, linewidths=0.6 + 1.6 * shade)
    draw_ends(axis, scene, theme)
    axis.set_title("three of them, at all five moments")
