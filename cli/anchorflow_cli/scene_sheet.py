"""A sheet of scenes: their maps, trajectories, starts and goals."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from anchorflow_client.errors import AnchorFlowError
from anchorflow_training.data import TrajectoryDataset
from anchorflow_training.data.homology import homology_classes, obstacle_points
from anchorflow_training.dataset import SceneDataset

SHEET = 4  # scenes a side
SIDE_INCHES = 2.6
COLOURS = 10  # of the cycle C0..C9
START, GOAL = "#1b7f3b", "#c62828"


class SheetError(AnchorFlowError):
    """A sheet cannot be written."""


@dataclass(frozen=True)
class Panel:
    """One scene: trajectories [M, T, 2] m with their classes [M], and its map, if any.

    occupancy: [H, W]; extent: (left, right, bottom, top) m
    """

    title: str
    positions: NDArray[np.floating]
    classes: NDArray[np.int64]
    occupancy: NDArray[np.floating] | None = None
    extent: tuple[float, float, float, float] | None = None


def draw_sheet(dataset: SceneDataset | TrajectoryDataset, path: Path) -> None:
    """Writes a picture of up to 16 scenes, evenly spread; a colour is a homology class.

    Raises `SheetError` where `path` cannot be written or has no picture's suffix.
    """
    picked = np.unique(np.linspace(0, len(dataset) - 1, SHEET**2).astype(int))
    panel = scene_panel if isinstance(dataset, SceneDataset) else trajectory_panel
    columns = min(SHEET, len(picked))
    rows = -(-len(picked) // columns)
    figure = Figure(figsize=(SIDE_INCHES * columns, SIDE_INCHES * rows), layout="constrained")
    axes = np.ravel(figure.subplots(rows, columns, squeeze=False))
    for place in axes[len(picked) :]:
        place.set_axis_off()
    for place, index in zip(axes, picked, strict=False):
        draw_panel(place, panel(dataset, int(index)))  # type: ignore[arg-type]
    try:
        figure.savefig(path, dpi=130)
    except (OSError, ValueError) as error:
        raise SheetError(f"{path}: {error}") from error


def scene_panel(dataset: SceneDataset, index: int) -> Panel:
    *origin, resolution = dataset.arrays["map_geometry"][index].tolist()
    clearance = np.asarray(dataset.arrays["clearance"][index], np.float32)
    positions = np.asarray(dataset.arrays["states"][index][..., :2])
    classes = homology_classes(positions, obstacle_points(clearance, resolution, np.array(origin)))
    occupancy = dataset.arrays["cost_map"][index, 0] / 255
    title = f"{index}, classes: {len(np.unique(classes))}"
    return Panel(title, positions, classes, occupancy, _extent(occupancy, origin, resolution))


def trajectory_panel(dataset: TrajectoryDataset, index: int) -> Panel:
    arrays = dataset.samples([index])
    positions, classes = arrays["positions"][..., :2], np.zeros(1, np.int64)
    geometry = dataset.map_geometry(np.array([index]))
    title = f"row {dataset.rows[index]}"
    if geometry is None:
        return Panel(title, positions, classes)
    *origin, resolution = geometry[0].tolist()
    occupancy = arrays["cost_maps"][0, 0]
    return Panel(title, positions, classes, occupancy, _extent(occupancy, origin, resolution))


def draw_panel(axes: Axes, panel: Panel) -> None:
    if panel.occupancy is not None:
        axes.imshow(
            panel.occupancy, cmap="Greys", vmin=0, vmax=1.3, origin="lower", extent=panel.extent
        )
    for path, kind in zip(panel.positions, panel.classes, strict=True):
        axes.plot(*path.T, color=f"C{kind % COLOURS}", linewidth=0.9)
    first, last = panel.positions[0, 0], panel.positions[0, -1]
    for point, color, marker in ((first, START, "o"), (last, GOAL, "*")):
        axes.plot(*point, color=color, marker=marker, markersize=6, zorder=5)
    axes.set_title(panel.title, fontsize=8)
    axes.set_aspect("equal", adjustable="datalim" if panel.occupancy is None else "box")
    axes.tick_params(labelsize=6)


def _extent(
    occupancy: NDArray[np.floating], origin: list[float], resolution: float
) -> tuple[float, float, float, float]:
    (left, bottom), (height, width) = origin, occupancy.shape
    return left, left + width * resolution, bottom, bottom + height * resolution
