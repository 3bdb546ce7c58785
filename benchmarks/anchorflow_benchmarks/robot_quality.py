"""Robots: the same scenes, asked as slower, faster, smaller and larger robots would ask them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from anchorflow_benchmarks.grid_path import shortest_way
from anchorflow_benchmarks.planners import EnginePlanner
from anchorflow_benchmarks.quality import judge_planners, quality_row
from anchorflow_benchmarks.report import ResultTable, Row
from anchorflow_training.scenes import FamilyScene
from anchorflow_trajectory.cost import MotionLimits

SPEEDS = ((0.26, 1.0), (0.5, 2.5), (2.0, 3.0), (5.0, 4.0))
"""v_max m/s and a_max m/s^2: TurtleBot3, the default of Nav2, a Jackal, an outdoor robot."""
RADII = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
COLUMNS = (
    "success",
    "any",
    "recall",
    "haste",
    "duration",
    "length",
    "clear",
    "duplicates",
    "unsafe_called_safe",
    "ms",
)


@dataclass(frozen=True)
class AskedRobot:
    """v_max: m/s; a_max: m/s^2; radius: m. None: as the bundle's card and the scene have it."""

    v_max: float | None = None
    a_max: float | None = None
    radius: float | None = None

    def limits(self, own: MotionLimits) -> MotionLimits:
        """Over those of the card."""
        v_max, a_max = self.v_max or own.v_max, self.a_max or own.a_max
        return replace(own, v_max=v_max, a_max=a_max)

    def scene(self, scene: FamilyScene, own: MotionLimits) -> FamilyScene:
        """The scene as this robot meets it: no end moves faster than it can.

        own: the limits that the scene was drawn for; velocities and accelerations shrink with them
        """
        limits = self.limits(own)
        slower, weaker = (
            min(1.0, mine / drawn)
            for mine, drawn in ((limits.v_max, own.v_max), (limits.a_max, own.a_max))
        )
        x_curr, x_goal = (state.copy() for state in (scene.x_curr, scene.x_goal))
        dim = len(x_goal) // 2
        x_curr[dim : 2 * dim] *= slower
        x_curr[2 * dim :] *= weaker
        x_goal[dim:] *= slower
        radius = self.radius or scene.robot_radius
        return replace(scene, x_curr=x_curr, x_goal=x_goal, robot_radius=radius, motion=limits)


def robot_tables(
    planners: Sequence[EnginePlanner],
    scenes: Sequence[FamilyScene],
    *,
    own: MotionLimits,
    num: int,
    progress: Callable[[int], None] = lambda _: None,
) -> list[ResultTable]:
    """A row a robot and planner: SPEEDS on the scenes' own radius, RADII at the card's limits.

    own: the limits that the scenes were drawn for. Of a radius, the scenes whose ways stay open for
    it count. `progress` gets 1 a scene and robot.

    Raises:
        InvalidRequest: a bundle's card has no such range.
    """
    by_speed = [AskedRobot(v_max=v_max, a_max=a_max) for v_max, a_max in SPEEDS]
    by_radius = [AskedRobot(radius=radius) for radius in RADII]
    titles = {"Robots by speed": by_speed, "Robots by radius": by_radius}
    note = "scenes: those whose way stays open for the radius"
    return [
        ResultTable(
            title,
            [
                row
                for robot in robots
                for row in _rows(robot, planners, scenes, own=own, num=num, progress=progress)
            ],
            note,
        )
        for title, robots in titles.items()
    ]


def _rows(
    robot: AskedRobot,
    planners: Sequence[EnginePlanner],
    scenes: Sequence[FamilyScene],
    *,
    own: MotionLimits,
    num: int,
    progress: Callable[[int], None],
) -> Iterator[Row]:
    limits = robot.limits(own)
    met = [robot.scene(scene, own) for scene in scenes]
    opened = [scene for scene in met if is_open(scene)]
    progress(len(met) - len(opened))
    if not opened:
        return
    asked = [replace(planner, limits=limits) for planner in planners]
    plans = judge_planners(asked, opened, limits=limits, num=num, progress=progress)
    for planner in asked:
        row = quality_row(planner, plans[planner.name])
        yield {
            "v_max": limits.v_max,
            "a_max": limits.a_max,
            "radius": robot.radius,
            "planner": planner.name,
            "scenes": len(opened),
        } | {column: row[column] for column in COLUMNS}


def is_open(scene: FamilyScene) -> bool:
    """Whether the robot fits at both ends and there is a way between them."""
    ends = np.stack([scene.x_curr[:2], scene.x_goal[:2]]) - scene.origin
    columns, rows = np.clip(ends / scene.resolution, 0, None).astype(int).T
    height, width = scene.occupied.shape
    cells = (rows.clip(max=height - 1), columns.clip(max=width - 1))
    return bool((scene.clearance_field[cells] > 0.0).all()) and bool(
        np.isfinite(shortest_way(scene))
    )
