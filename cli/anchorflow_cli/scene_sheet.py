"""Draw a sheet of scenes: maps, trajectories, starts and goals."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from anchorflow_cli.plots import save
from anchorflow_training.data import TrajectoryDataset
from anchorflow_training.data.inspection import homology_classes, obstacle_points
from anchorflow_training.dataset import SceneDataset
from anchorflow_trajectory.drawing import draw_cells, draw_ends, draw_paths, sheet

SHEET = 4  # scenes a side
SIDE_INCHES = 2.6
COLOURS = 10  # of the cycle C0..C9


@dataclass(frozen=True)
class Panel:
    """One scene: trajectories [M, T, 2] m with their classes [M], and its map [H, W], if any.

    geometry: [3] of the map: origin x and y [m], resolution [m/cell]
    """

    title: str
    positions: NDArray[np.floating]
    classes: NDArray[np.int64]
    occupancy: NDArray[np.floating] | None = None
    geometry: NDArray[np.floating] | None = None


def draw_sheet(dataset: SceneDataset | TrajectoryDataset, path: Path) -> None:
    """Write a picture of up to 16 scenes, evenly spread; a colour is a homology class.

    Raises `PlotError` if `path` cannot be written or its suffix is not a picture's.
    """
    picked = np.unique(np.linspace(0, len(dataset) - 1, SHEET**2).astype(int))
    panel = scene_panel if isinstance(dataset, SceneDataset) else trajectory_panel
    figure, axes = sheet(len(picked), columns=SHEET, inches=SIDE_INCHES, header=0.3)
    for place, index in zip(axes, picked, strict=True):
        draw_panel(place, panel(dataset, int(index)))  # type: ignore[arg-type]
    save(figure, path, dpi=130)


def scene_panel(dataset: SceneDataset, index: int) -> Panel:
    geometry = np.asarray(dataset.arrays["map_geometry"][index])
    clearance = np.asarray(dataset.arrays["clearance"][index], np.float32)
    positions = np.asarray(dataset.arrays["states"][index][..., :2])
    classes = homology_classes(
        positions, obstacle_points(clearance, float(geometry[2]), geometry[:2])
    )
    occupancy = dataset.arrays["cost_map"][index, 0] / 255
    title = f"{index}, classes: {len(np.unique(classes))}"
    return Panel(title, positions, classes, occupancy, geometry)


def trajectory_panel(dataset: TrajectoryDataset, index: int) -> Panel:
    arrays = dataset.samples([index])
    positions, classes = arrays["positions"][..., :2], np.zeros(1, np.int64)
    geometry = dataset.map_geometry(np.array([index]))
    title = f"row {dataset.rows[index]}"
    if geometry is None:
        return Panel(title, positions, classes)
    return Panel(title, positions, classes, arrays["cost_maps"][0, 0], geometry[0])


def draw_panel(axes: Axes, panel: Panel) -> None:
    if panel.occupancy is not None and panel.geometry is not None:
        *origin, resolution = panel.geometry.tolist()
        draw_cells(axes, panel.occupancy, resolution=resolution, origin=origin)
    colours = [f"C{kind % COLOURS}" for kind in panel.classes]
    draw_paths(axes, panel.positions, colours, linewidths=0.9)
    draw_ends(axes, panel.positions[0, 0], panel.positions[0, -1])
    axes.set_title(panel.title, fontsize=8)
    axes.set_aspect("equal", adjustable="datalim" if panel.occupancy is None else "box")
    axes.tick_params(labelsize=6)
