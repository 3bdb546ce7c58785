"""Picture of a robot with an outline and wheels: a door, a corner and a parking bay."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from anchorflow_cli.body_plots import cusps, gears_of, outlines_at
from anchorflow_client.contract import AnchorBatch, AnchorRequest, resolve_for_card
from anchorflow_docs.pictures.scenes import Stage
from anchorflow_docs.pictures.theme import WIDTH, Array, Drawing, Theme
from anchorflow_trajectory.drawing import (
    draw_cells,
    draw_ends,
    draw_outlines,
    draw_paths,
    hide_ticks,
)

RESOLUTION, CELLS = 0.05, 112
EVERY_S = 0.5
FORKLIFT = [[0.45, 0.31], [-0.45, 0.31], [-0.45, -0.31], [0.45, -0.31]]
CAR = [[0.5, 0.25], [-0.2, 0.25], [-0.2, -0.25], [0.5, -0.25]]
CART = {"kind": "differential", "omega_max": 2.0}
STEERED = {"kind": "ackermann", "min_turning_radius": 0.8, "reverse": True}
GEARS = {1: 0, -1: 1, 0: 4}  # places of their colours among those of ways


@dataclass(frozen=True)
class Place:
    """A map, a robot and its way; poses are x, y in m and heading in rad."""

    title: str
    free: tuple[tuple[float, float, float, float], ...]
    """Rectangles x0, x1, y0, y1 m."""
    start: tuple[float, float, float]
    goal: tuple[float, float, float]
    corners: list[list[float]]
    wheels: dict[str, Any] = field(default_factory=dict)

    @property
    def walls(self) -> Array:
        """Occupancy [H, W] of a map centred on (0, 0)."""
        walls = np.ones((CELLS, CELLS))
        for sides in self.free:
            x0, x1, y0, y1 = (round(side / RESOLUTION) + CELLS // 2 for side in sides)
            walls[y0:y1, x0:x1] = 0.0
        return walls


PLACES = (
    Place(
        "a turn on the spot, and a door of 0.9 m",
        ((-2.4, -0.1, -2.0, 2.0), (0.1, 2.4, -2.0, 2.0), (-0.1, 0.1, -0.45, 0.45)),
        (-1.3, 1.2, 0.75 * np.pi),
        (1.6, -0.8, 0.0),
        FORKLIFT,
        CART,
    ),
    Place(
        "an aisle of 1.2 m",
        ((-2.4, 0.6, 0.8, 2.0), (-0.6, 0.6, -2.0, 2.0)),
        (-1.8, 1.4, 0.0),
        (0.0, -1.4, -np.pi / 2),
        FORKLIFT,
        CART,
    ),
    Place(
        "backwards into a bay",
        ((-2.4, 2.4, -0.2, 1.6), (-0.45, 0.45, -1.6, 0.0)),
        (-1.6, 0.6, 0.0),
        (0.0, -1.1, np.pi / 2),
        CAR,
        STEERED,
    ),
)


def bodies(stage: Stage) -> Drawing:
    """Draw three scenes with the robot along the best anchor, in colours of its gears."""
    answers = [_plan(stage, place) for place in PLACES]

    def draw(theme: Theme) -> Figure:
        size = (WIDTH, WIDTH / len(PLACES) * 0.98)
        figure, axes = plt.subplots(1, len(PLACES), figsize=size, layout="constrained")
        for axis, place, answer in zip(axes, PLACES, answers, strict=True):
            _draw(axis, place, answer, theme)
        return figure

    return draw


def _plan(stage: Stage, place: Place) -> AnchorBatch:
    request = AnchorRequest.build(
        cost_map={"data": place.walls[None], "resolution": RESOLUTION},
        x_curr=[*place.start, *np.zeros(6)],
        x_goal=[*place.goal, *np.zeros(3)],
        footprint=place.corners,
        kinematics=place.wheels,
        v_max=1.0,
        a_max=1.5,
        seed=0,
    )
    return stage.engine.plan(resolve_for_card(request, stage.engine.card))


def _draw(axis: Axes, place: Place, answer: AnchorBatch, theme: Theme) -> None:
    half = RESOLUTION * CELLS / 2
    origin = (-half, -half)
    draw_cells(axis, place.walls, resolution=RESOLUTION, origin=origin, cmap=theme.cells, vmax=1.0)
    hide_ticks(axis)
    axis.spines[:].set_visible(False)
    draw_paths(axis, answer.trajectories, theme.ways[2], alpha=0.35)
    best = answer.best
    poses, rates = answer.trajectories[best], answer.velocities[best]
    drawn, gears = outlines_at(poses, rates, answer.durations[best], every=EVERY_S)
    for gear, colour in GEARS.items():
        look = {"edgecolors": theme.ways[colour], "linewidths": 0.9}
        draw_outlines(axis, drawn[gears == gear], np.array(place.corners), **look)
    axis.plot(*poses[:, :2].T, color=theme.ink, linewidth=1.4)
    at = poses[cusps(gears_of(poses, rates))]
    axis.plot(*at[:, :2].T, "D", color=theme.ways[GEARS[-1]], markersize=4.5, zorder=6)
    ends = {"colours": (theme.start, theme.goal), "sizes": (6, 10), "markeredgecolor": theme.page}
    draw_ends(axis, place.start, place.goal, **ends)
    axis.set_title(place.title)
