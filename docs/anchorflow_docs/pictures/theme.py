"""How pictures look, on a light page and on a dark one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import Colormap, LinearSegmentedColormap, ListedColormap
from matplotlib.figure import Figure
from PIL import Image

from anchorflow_docs.picture_variants import dark_variant

WIDTH = 9.2
"""Inches; at DOTS_PER_INCH twice the width of a page's column, for sharp screens."""
DOTS_PER_INCH = 160
COLOURS = 255
"""Of a picture's palette; more would double the files and show nothing."""
PALETTE_ROUNDS = 2
"""In which the palette is fitted to the picture; without them rare colours are lost."""
SHADES = 31
"""Of a field, which leaves the palette colours for the rest."""


@dataclass(frozen=True)
class Theme:
    """Colours of one of the two."""

    is_dark: bool
    page: str
    """As the site's style sheet has it: a picture has no edge."""
    ink: str
    faint: str
    ground: str
    obstacle: str
    start: str
    goal: str
    scores: Colormap
    """From the worst score to the best."""
    ways: tuple[str, ...]
    """For things of different kinds, told apart by the colour-blind too."""

    @property
    def cells(self) -> Colormap:
        """From a free cell to an occupied one."""
        return LinearSegmentedColormap.from_list("cells", [self.ground, self.obstacle])

    @property
    def costs(self) -> Colormap:
        """Of soft costs, from none to the highest."""
        return LinearSegmentedColormap.from_list("costs", [self.ground, self.goal])

    @property
    def room(self) -> Colormap:
        """Of clearance: below 0, at 0, above."""
        colours = [self.goal, self.ground, self.ways[0]]
        return LinearSegmentedColormap.from_list("room", colours, N=SHADES)

    @property
    def settings(self) -> dict[Any, Any]:
        """For matplotlib."""
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
    """A stretch of one of matplotlib's colour maps; backwards where low is above high."""
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
"""A picture whose data is there: called once for each theme."""


def save(path: Path, draw: Drawing) -> None:
    """Draw a picture twice: `path` for light pages, its dark variant beside it."""
    for theme in (LIGHT, DARK):
        with plt.rc_context(theme.settings):
            figure = draw(theme)
            _write(figure, dark_variant(path) if theme.is_dark else path)
            plt.close(figure)


def _write(figure: Figure, path: Path) -> None:
    """A small PNG, of the same bytes for the same picture."""
    drawn = BytesIO()
    figure.savefig(drawn, dpi=DOTS_PER_INCH, bbox_inches="tight", pad_inches=0.05)
    image = Image.open(drawn).convert("RGB")
    palette = image.quantize(COLOURS, kmeans=PALETTE_ROUNDS, dither=Image.Dither.NONE)
    palette.save(path, optimize=True)
