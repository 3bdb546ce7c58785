"""A picture of sampled anchors on their maps."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anchorflow_training.evaluation import JudgedScene

LOG = logging.getLogger(__name__)

SIZE = 3.0  # inches a scene, at 100 dots an inch


def sample_picture(scenes: Sequence[JudgedScene]) -> NDArray[np.uint8] | None:
    """Scenes side by side as [height, width, 3]; None, with a line in the log, without matplotlib.

    Anchors that succeed are green, the others red.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ModuleNotFoundError:
        LOG.warning("no sample picture: matplotlib is not installed (pip install matplotlib)")
        return None
    figure = Figure(figsize=(SIZE * len(scenes), SIZE), dpi=100, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    for axes, scene in zip(figure.subplots(1, len(scenes), squeeze=False)[0], scenes, strict=True):
        x, y, resolution = scene.map_geometry
        height, width = scene.cost_map.shape[1:]
        extent = (x, x + width * resolution, y, y + height * resolution)
        axes.imshow(scene.cost_map[0], cmap="Greys", origin="lower", extent=extent, vmin=0, vmax=1)
        for path, good in zip(scene.positions, scene.checks.success, strict=True):
            axes.plot(path[:, 0], path[:, 1], color="tab:green" if good else "tab:red", lw=0.8)
        axes.plot(*scene.x_curr[:2], "ko", ms=4)
        axes.plot(*scene.x_goal[:2], "k*", ms=7)
        axes.set(xlim=extent[:2], ylim=extent[2:], xticks=[], yticks=[])
        axes.set_title(f"{scene.checks.success.mean():.0%}", fontsize=8)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def save_picture(path: Path, picture: NDArray[np.uint8]) -> None:
    """Write a picture of `sample_picture` as PNG."""
    from matplotlib.image import imsave

    path.parent.mkdir(parents=True, exist_ok=True)
    imsave(path, picture)
