"""Draw anchors on their map."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from anchorflow_cli.body_plots import draw_body
from anchorflow_cli.options import Vector
from anchorflow_client.contract import AnchorBatch, Obstacles
from anchorflow_client.errors import AnchorFlowError
from anchorflow_client.ros_map import RosMap
from anchorflow_trajectory.drawing import draw_cells, draw_ends, draw_paths

FREE, UNKNOWN, OCCUPIED = "white", "#c9ccd1", "#3b4048"
TRACK_STEPS = 64
DISC = "#a3268f"


class PlotError(AnchorFlowError):
    """A picture cannot be written."""


def draw_anchors(
    anchors: AnchorBatch,
    ros_map: RosMap,
    *,
    start: Vector,
    goal: Vector,
    path: Path,
    obstacles: Obstacles | None = None,
    outline: Vector | None = None,
) -> None:
    """Write a picture of a map [H, W] and the anchors [N, T, D] on it, in the format of `path`.

    Colour is the score, unsafe anchors are dashed, and the best one is outlined. With obstacles,
    colour is the time, along the anchors and along the tracks of what moves. With an outline
    [K, 2] m, anchors are poses, and the robot is drawn along the best one. The title has the
    durations of all, the legend that of the best.

    Raises `PlotError` if `path` cannot be written or its suffix is not a picture's.
    """
    figure = Figure(figsize=(8.0, 7.0), layout="constrained")
    axes = figure.add_subplot()
    draw_map(axes, ros_map)
    if obstacles is None:
        lines, label, extend = draw_lines(axes, anchors), "score (higher is better)", "min"
    else:
        lines, label, extend = draw_times(axes, anchors, obstacles), "time [s]", "neither"
    if outline is not None:
        draw_body(axes, anchors, outline)
    draw_ends(axes, start, goal, sizes=(12.0, 12.0), named=True, markeredgecolor="white")
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    safe = f"{anchors.safe.sum()} of {anchors.safe.size} anchors are safe"
    axes.set_title(f"{safe}, {durations_text(anchors)}", loc="left")
    figure.legend(loc="outside lower center", ncols=4, frameon=False)
    figure.colorbar(lines, ax=axes, label=label, extend=extend, shrink=0.8)
    save(figure, path, dpi=150)


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


def draw_times(axes: Axes, anchors: AnchorBatch, obstacles: Obstacles) -> LineCollection:
    """Draw anchors and obstacles' tracks, coloured by time; return the lines for a colour bar.

    Discs are the obstacles now. Unsafe anchors are dashed and grey.
    """
    paths, safe, best = anchors.trajectories[..., :2], anchors.safe, anchors.best
    times = np.linspace(0.0, anchors.durations, paths.shape[1], axis=-1)
    longest = float(times.max())
    if not safe.all():
        draw_paths(axes, paths[~safe], "grey", linestyles="dashed", alpha=0.5)
        axes.plot([], [], color="grey", linestyle="dashed", label="not safe")
    draw_timed(axes, paths[safe], times[safe], longest, linewidths=1.2, alpha=0.8)
    colour = "black" if safe[best] else "grey"
    label = f"best, {anchors.durations[best]:.1f} s"
    axes.plot(*paths[best].T, color=colour, linewidth=5, label=label)
    lines = draw_timed(axes, paths[[best]], times[[best]], longest, linewidths=2.5, zorder=3)
    track = np.linspace(0.0, longest, TRACK_STEPS)
    tracks = obstacles.places(track)
    draw_timed(axes, tracks, np.broadcast_to(track, tracks.shape[:2]), longest, linewidths=3)
    rounds = zip(obstacles.position, obstacles.radius, strict=True)
    discs = PatchCollection([Circle((x, y), radius) for (x, y), radius in rounds])
    discs.set(facecolor=DISC, alpha=0.6, zorder=4)
    axes.add_collection(discs)
    axes.plot([], [], "o", color=DISC, alpha=0.6, markersize=12.0, label="obstacle, now")
    return lines


def draw_timed(
    axes: Axes, paths: NDArray, times: NDArray, longest: float, **look: Any
) -> LineCollection:
    """Draw paths [N, T, 2] m in colours of their times [N, T], from 0 to the longest."""
    legs = np.stack([paths[:, :-1], paths[:, 1:]], axis=2).reshape(-1, 2, 2)
    middles = (times[:, :-1] + times[:, 1:]).ravel() / 2
    lines = draw_paths(axes, legs, array=middles, cmap="viridis", **look)
    lines.set_clim(0.0, longest)
    return lines
