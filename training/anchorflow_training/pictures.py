"""A picture of sampled anchors on their maps."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anchorflow_training.evaluation import JudgedScene

LOG = logging.getLogger(__name__)

SIZE, DOTS_PER_INCH = 3.0, 100  # of a scene's panel
GOOD, BAD = "tab:green", "tab:red"


def sample_picture(scenes: Sequence[JudgedScene]) -> NDArray[np.uint8] | None:
    """Scenes side by side as [height, width, 3]; None, with a line in the log, without matplotlib.

    Anchors that succeed are green, the others red.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        from anchorflow_trajectory import drawing
    except ModuleNotFoundError:
        LOG.warning("no sample picture: matplotlib is not installed (pip install matplotlib)")
        return None
    figure, panels = drawing.sheet(len(scenes), columns=len(scenes), inches=SIZE)
    figure.set_dpi(DOTS_PER_INCH)
    canvas = FigureCanvasAgg(figure)
    for axes, scene in zip(panels, scenes, strict=True):
        x, y, resolution = scene.map_geometry
        drawing.draw_cells(axes, scene.cost_map[0], resolution=resolution, origin=(x, y))
        colours = np.where(scene.checks.success, GOOD, BAD)
        drawing.draw_paths(axes, scene.positions, colours, linewidths=0.8)
        drawing.draw_ends(
            axes, scene.x_curr, scene.x_goal, colours=("black", "black"), sizes=(4, 7)
        )
        drawing.hide_ticks(axes)
        axes.set_title(f"{scene.checks.success.mean():.0%}", fontsize=8)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def save_picture(path: Path, picture: NDArray[np.uint8]) -> None:
    """Write a picture of `sample_picture` as PNG."""
    from matplotlib.image import imsave

    path.parent.mkdir(parents=True, exist_ok=True)
    imsave(path, picture)
