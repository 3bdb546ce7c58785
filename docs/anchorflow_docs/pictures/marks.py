"""What stands on every map: cells, anchors, start and goal."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from anchorflow_client.contract import AnchorBatch
from anchorflow_docs.pictures.theme import Theme
from anchorflow_trajectory import drawing
from anchorflow_trajectory.drawing import draw_cells, draw_paths, hide_ticks
from anchorflow_trajectory.scene import Scene

Array = NDArray[np.floating]

MARGIN_M = 0.8


def draw_map(axis: Axes, scene: Scene, theme: Theme) -> None:
    """The occupancy, from corner to corner, in metres without figures."""
    draw_field(axis, scene, scene.cost_map[0], cmap=theme.cells, vmin=0.0, vmax=1.0)


def draw_field(axis: Axes, scene: Scene, values: Array, **look: Any) -> Any:
    """A field [H,W] over the map; returns matplotlib's image, for a colour bar."""
    image = draw_cells(axis, values, resolution=scene.resolution, origin=scene.origin, **look)
    hide_ticks(axis)
    axis.spines[:].set_visible(False)
    return image


def draw_ends(axis: Axes, scene: Scene, theme: Theme) -> None:
    """Start and goal, with arrows where the robot moves there."""
    colours = (theme.start, theme.goal)
    look = {"markeredgecolor": theme.page, "zorder": 6, "clip_on": False}  # some lie on the edge
    drawing.draw_ends(axis, scene.x_curr, scene.x_goal, colours=colours, sizes=(8, 14), **look)
    for state, colour in zip((scene.x_curr, scene.x_goal), colours, strict=True):
        (x, y), velocity = state[:2], state[2:4]
        if np.linalg.norm(velocity) > 0.1:
            end = (x + velocity[0] * 0.6, y + velocity[1] * 0.6)
            arrow = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.8, "shrinkA": 0}
            axis.annotate(
                "", xytext=(x, y), xy=end, arrowprops=arrow, zorder=5, annotation_clip=False
            )


def draw_anchors(axis: Axes, anchors: AnchorBatch, theme: Theme) -> None:
    """All anchors of one scene by score, the best above the rest, those not safe dashed."""
    order = np.argsort(anchors.scores)
    colours = theme.scores(np.linspace(0.0, 1.0, len(order)))
    safe = anchors.safe[order]
    for kept, dashes in ((~safe, (0, (4, 2))), (safe, "-")):
        draw_paths(
            axis, anchors.trajectories[order][kept], colours[kept], linestyles=[dashes], alpha=0.8
        )
    draw_best(axis, anchors, theme)


def crop_to(axis: Axes, scene: Scene, paths: Array) -> None:
    """Show the map's whole width, and of its height what lies around paths [N,T,D]."""
    bottom = scene.origin[1]
    top = bottom + scene.cost_map.shape[-2] * scene.resolution
    y = paths[..., 1]
    axis.set_ylim(max(bottom, y.min() - MARGIN_M), min(top, y.max() + MARGIN_M))


def draw_best(axis: Axes, anchors: AnchorBatch, theme: Theme, colour: Any = None) -> None:
    """The anchor that a caller takes first."""
    axis.plot(
        *anchors.trajectories[anchors.best, :, :2].T,
        color=colour or theme.scores(1.0),
        linewidth=2.6,
        zorder=4,
        path_effects=[withStroke(linewidth=4.6, foreground=theme.ground)],
    )
