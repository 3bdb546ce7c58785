"""Draw a map and trajectories by matplotlib, an optional dependency."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.floating]

START, GOAL = "#1b7f3b", "#c62828"


def draw_cells(
    axes: Axes, values: ArrayLike, *, resolution: float, origin: ArrayLike, **look: Any
) -> AxesImage:
    """Values [H, W] of a map's cells, in metres and from edge to edge of the map.

    Args:
        axes: drawn on; they show the whole map and no more.
        values: row 0 is the bottom one. Unless `look` says otherwise 1 is dark, as for occupancy.
        resolution: m/cell.
        origin: [2] m, outer corner of cell (0, 0).
        look: as matplotlib's `imshow` takes it.
    """
    cells = np.asarray(values)
    left, bottom = np.asarray(origin, float)
    height, width = cells.shape
    extent = (left, left + width * resolution, bottom, bottom + height * resolution)
    look = {"cmap": "Greys", "vmin": 0.0, "vmax": 1.4, "interpolation": "nearest"} | look
    image = axes.imshow(cells, origin="lower", extent=extent, **look)
    axes.set(xlim=extent[:2], ylim=extent[2:])
    return image


def hide_ticks(axes: Axes) -> None:
    """No figures along the edges."""
    axes.set(xticks=[], yticks=[])


def draw_paths(axes: Axes, paths: Array, colours: Any = None, **look: Any) -> LineCollection:
    """Polylines [N, T, D], of which x and y [m] are drawn.

    Args:
        axes: drawn on.
        paths: their positions.
        colours: one for each, or one for all.
        look: as matplotlib's `LineCollection` takes it.
    """
    look = {"linewidths": 1.0, "capstyle": "round"} | look
    lines = LineCollection(list(paths[..., :2]), colors=colours, **look)
    axes.add_collection(lines)
    return lines


def draw_outlines(axes: Axes, poses: Array, corners: Array, **look: Any) -> PolyCollection:
    """Polygons of a robot at poses [K, 3], x and y [m] and heading [rad], each with a nose.

    Args:
        axes: drawn on.
        poses: of the robot's origin.
        corners: [C, 2] m, its outline about that origin, x forward.
        look: as matplotlib's `PolyCollection` takes it.
    """
    look = {"facecolors": "none", "linewidths": 1.0} | look
    cosine, sine = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    turn = np.array([[cosine, -sine], [sine, cosine]]).transpose(2, 0, 1)
    placed = poses[:, None, :2] + np.asarray(corners) @ turn.transpose(0, 2, 1)
    outlines = PolyCollection(list(placed), **look)
    axes.add_collection(outlines)
    front = float(np.max(np.asarray(corners)[:, 0]))
    noses = poses[:, None, :2] + np.array([[0.0, 0.0], [front, 0.0]]) @ turn.transpose(0, 2, 1)
    look = {key: value for key, value in look.items() if key != "facecolors"}
    axes.add_collection(LineCollection(list(noses), colors=look.pop("edgecolors", None), **look))
    return outlines


def draw_ends(
    axes: Axes,
    start: ArrayLike,
    goal: ArrayLike,
    *,
    colours: tuple[Any, Any] = (START, GOAL),
    sizes: tuple[float, float] = (6.0, 6.0),
    named: bool = False,
    **look: Any,
) -> None:
    """A dot at the start and a star at the goal, each given as [2] m or a state that begins so.

    Args:
        axes: drawn on.
        start, goal: of the trajectories.
        colours, sizes: of the start and the goal.
        named: whether a legend names them.
        look: as matplotlib's `plot` takes it.
    """
    look = {"zorder": 5} | look
    for point, marker, name, colour, size in zip(
        (start, goal), "o*", ("start", "goal"), colours, sizes, strict=True
    ):
        x, y = np.asarray(point)[:2]
        label = name if named else None
        axes.plot(
            x, y, marker, color=colour, markersize=size, linestyle="none", label=label, **look
        )


def sheet(
    count: int, *, columns: int, inches: float, header: float = 0.0
) -> tuple[Figure, list[Axes]]:
    """Make a figure of `count` square panels, row by row, under a header [inches]."""
    columns = min(columns, count)
    rows = -(-count // columns)
    figure = Figure((inches * columns, inches * rows + header), layout="constrained")
    panels = list(figure.subplots(rows, columns, squeeze=False).flat)
    for unused in panels[count:]:
        unused.set_axis_off()
    return figure, panels[:count]
