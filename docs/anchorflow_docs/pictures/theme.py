"""The style of pictures on light and dark pages, and the marks that they share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, LinearSegmentedColormap, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray
from PIL import Image

from anchorflow_client.contract import AnchorBatch
from anchorflow_docs.built_html import dark_variant
from anchorflow_trajectory import drawing
from anchorflow_trajectory.drawing import draw_cells, draw_paths, hide_ticks
from anchorflow_trajectory.scene import Scene

Array = NDArray[np.floating]

WIDTH = 9.2  # inches; at DOTS_PER_INCH twice the width of a page's column
DOTS_PER_INCH = 160
COLOURS = 255  # of a picture's palette; more would double the files
PALETTE_ROUNDS = 2  # of fitting the palette, without which rare colours are lost
SHADES = 31  # of a field, so that colours are left for the rest
MARGIN_M = 0.8


@dataclass(frozen=True)
class Theme:
    """Colours of light or dark pages."""

    is_dark: bool
    page: str  # the background of the site
    ink: str
    faint: str
    ground: str
    obstacle: str
    start: str
    goal: str
    scores: Colormap  # worst to best
    ways: tuple[str, ...]  # distinct for the colour-blind too

    @property
    def cells(self) -> Colormap:
        """Free to occupied."""
        return LinearSegmentedColormap.from_list("cells", [self.ground, self.obstacle])

    @property
    def costs(self) -> Colormap:
        """No soft cost to the highest."""
        return LinearSegmentedColormap.from_list("costs", [self.ground, self.goal])

    @property
    def room(self) -> Colormap:
        """Clearance below 0, at 0, above."""
        colours = [self.goal, self.ground, self.ways[0]]
        return LinearSegmentedColormap.from_list("room", colours, N=SHADES)

    @property
    def settings(self) -> dict[Any, Any]:
        """Settings of matplotlib."""
        return {
            "figure.facecolor": self.page,
            "axes.facecolor": self.page,
            "axes.edgecolor": self.faint,
            "axes.labelcolor": self.ink,
            "axes.titlesize": 10,
            "axes.titlecolor": self.ink,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "text.color": self.ink,
            "xtick.color": self.ink,
            "ytick.color": self.ink,
            "grid.color": self.faint,
            "grid.alpha": 0.4,
            "font.family": "DejaVu Sans",  # ships with matplotlib: the same everywhere
            "font.size": 9,
            "legend.frameon": False,
        }


def _part(name: str, low: float, high: float) -> Colormap:
    """Return part of a matplotlib colour map; reversed if low is above high."""
    whole = plt.get_cmap(name)
    return ListedColormap([whole(share) for share in np.linspace(low, high, 256)])


LIGHT = Theme(
    is_dark=False,
    page="#ffffff",
    ink="#24292f",
    faint="#b4bcc8",
    ground="#f1f3f6",
    obstacle="#4a5365",
    start="#00857a",
    goal="#d1304b",
    scores=_part("plasma", 0.82, 0.05),
    ways=("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#7a5cd6", "#a68a00"),
)
DARK = Theme(
    is_dark=True,
    page="#1e2129",
    ink="#dfe3ea",
    faint="#5b6372",
    ground="#2a2f3a",
    obstacle="#98a2b5",
    start="#34d3c2",
    goal="#ff6b81",
    scores=_part("plasma", 0.25, 0.95),
    ways=("#56b4e9", "#ff8c42", "#2fd39c", "#f49ac8", "#a996ff", "#f0e442"),
)


Drawing = Callable[[Theme], Figure]
"""A picture with its data, called once per theme."""


def save(path: Path, draw: Drawing) -> None:
    """Draw a picture for light pages at `path`, and its dark variant beside it."""
    for theme in (LIGHT, DARK):
        with plt.rc_context(theme.settings):
            figure = draw(theme)
            _write(figure, dark_variant(path) if theme.is_dark else path)
            plt.close(figure)


def _write(figure: Figure, path: Path) -> None:
    """Write a small PNG with the same bytes for the same picture."""
    drawn = BytesIO()
    figure.savefig(drawn, dpi=DOTS_PER_INCH, bbox_inches="tight", pad_inches=0.05)
    image = Image.open(drawn).convert("RGB")
    palette = image.quantize(COLOURS, kmeans=PALETTE_ROUNDS, dither=Image.Dither.NONE)
    palette.save(path, optimize=True)


def draw_map(axis: Axes, scene: Scene, theme: Theme) -> None:
    """Draw the occupancy of the whole map."""
    draw_field(axis, scene, scene.cost_map[0], cmap=theme.cells, vmin=0.0, vmax=1.0)


def draw_field(axis: Axes, scene: Scene, values: Array, **look: Any) -> Any:
    """Draw a field [H,W] over the map; return matplotlib's image for a colour bar."""
    image = draw_cells(axis, values, resolution=scene.resolution, origin=scene.origin, **look)
    hide_ticks(axis)
    axis.spines[:].set_visible(False)
    return image


def draw_ends(axis: Axes, scene: Scene, theme: Theme) -> None:
    """Draw start and goal, with arrows for their velocities."""
    colours = (theme.start, theme.goal)
    look = {"markeredgecolor": theme.page, "zorder": 6, "clip_on": False}  # some are on the edge
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
    """Draw all anchors coloured by score, the best on top, unsafe ones dashed."""
    order = np.argsort(anchors.scores)
    colours = theme.scores(np.linspace(0.0, 1.0, len(order)))
    safe = anchors.safe[order]
    for kept, dashes in ((~safe, (0, (4, 2))), (safe, "-")):
        draw_paths(
            axis, anchors.trajectories[order][kept], colours[kept], linestyles=[dashes], alpha=0.8
        )
    draw_best(axis, anchors, theme)


def crop_to(axis: Axes, scene: Scene, paths: Array) -> None:
    """Show the map's whole width, and its height around paths [N,T,D]."""
    bottom = scene.origin[1]
    top = bottom + scene.cost_map.shape[-2] * scene.resolution
    y = paths[..., 1]
    axis.set_ylim(max(bottom, y.min() - MARGIN_M), min(top, y.max() + MARGIN_M))


def draw_best(axis: Axes, anchors: AnchorBatch, theme: Theme, colour: Any = None) -> None:
    axis.plot(
        *anchors.trajectories[anchors.best, :, :2].T,
        color=colour or theme.scores(1.0),
        linewidth=2.6,
        zorder=4,
        path_effects=[withStroke(linewidth=4.6, foreground=theme.ground)],
    )


def draw_answer(axis: Axes, scene: Scene, answer: AnchorBatch, theme: Theme) -> None:
    """Draw map, anchors, start and goal."""
    draw_map(axis, scene, theme)
    draw_anchors(axis, answer, theme)
    draw_ends(axis, scene, theme)
