"""Draw anchors on their map."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from anchorflow_cli.options import Vector
from anchorflow_client.contract import AnchorBatch
from anchorflow_client.errors import AnchorFlowError
from anchorflow_client.ros_map import RosMap
from anchorflow_trajectory.drawing import draw_cells, draw_ends, draw_paths

FREE, UNKNOWN, OCCUPIED = "white", "#c9ccd1", "#3b4048"


class PlotError(AnchorFlowError):
    """A picture cannot be written."""


def draw_anchors(
    anchors: AnchorBatch, ros_map: RosMap, *, start: Vector, goal: Vector, path: Path
) -> None:
    """Write a picture of a map [H, W] and the anchors [N, T, D] on it, in the format of `path`.

    Colour is the score, unsafe anchors are dashed, and the best one is outlined. The title has the
    durations of all, the legend that of the best.

    Raises `PlotError` if `path` cannot be written or its suffix is not a picture's.
    """
    figure = Figure(figsize=(8.0, 7.0), layout="constrained")
    axes = figure.add_subplot()
    draw_map(axes, ros_map)
    lines = draw_lines(axes, anchors)
    draw_ends(axes, start, goal, sizes=(12.0, 12.0), named=True, markeredgecolor="white")
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.set_title(f"{safe_text(anchors)}, {durations_text(anchors)}", loc="left")
    figure.legend(loc="outside lower center", ncols=4, frameon=False)
    figure.colorbar(lines, ax=axes, label="score (higher is better)", extend="min", shrink=0.8)
    save(figure, path, dpi=150)


def safe_text(anchors: AnchorBatch) -> str:
    """Return text such as `63 of 64 anchors are safe`."""
    return f"{anchors.safe.sum()} of {anchors.safe.size} anchors are safe"


def durations_text(anchors: AnchorBatch) -> str:
    """Return the durations of safe anchors, or of all if none is: `4.2 to 9.1 s` or `8.0 s`."""
    lasting = anchors.durations[anchors.safe] if anchors.safe.any() else anchors.durations
    least, most = f"{lasting.min():.1f}", f"{lasting.max():.1f}"
    return f"{most} s" if least == most else f"{least} to {most} s"


def save(figure: Figure, path: Path, *, dpi: int) -> None:
    """Save a figure; raise `PlotError` if `path` cannot be written as a picture."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=dpi)
    except (OSError, ValueError) as error:
        raise PlotError(f"{path}: {error}") from error


def draw_map(axes: Axes, ros_map: RosMap) -> None:
    """Draw occupied and unknown cells in two shades of grey, in metres."""
    shade = np.where(ros_map.unknown, 1, np.where(ros_map.occupancy >= 0.5, 2, 0))
    shades = ListedColormap([FREE, UNKNOWN, OCCUPIED])
    draw_cells(
        axes, shade, resolution=ros_map.resolution, origin=ros_map.origin, cmap=shades, vmax=2
    )


def draw_lines(axes: Axes, anchors: AnchorBatch) -> LineCollection:
    """Draw the anchors, the best on top; return the lines for a colour bar."""
    paths, scores, best = anchors.trajectories, anchors.scores, anchors.best
    styles = np.where(anchors.safe, "solid", "dashed")
    order = np.argsort(scores)
    lines = draw_paths(
        axes,
        paths[order],
        array=scores[order],
        cmap="viridis",
        linewidths=1.2,
        linestyles=list(styles[order]),
        alpha=0.8,
    )
    # Scores of anchors through walls would compress the scale of the others.
    scale = scores[anchors.safe] if anchors.safe.any() else scores
    lines.set_clim(scale.min(), scale.max())
    axes.plot(
        *paths[best, :, :2].T,
        color=lines.to_rgba(scores[best]),
        linewidth=2.5,
        linestyle=styles[best],
        path_effects=[withStroke(linewidth=5, foreground="black")],
        label=f"best, {anchors.durations[best]:.1f} s",
    )
    if not anchors.safe.all():
        axes.plot([], [], color="grey", linestyle="dashed", label="not safe")
    return lines
