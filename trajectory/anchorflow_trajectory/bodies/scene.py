"""One planning problem of a body: its scene, outline and wheels, and what follows from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.bodies.motion import Limits
from anchorflow_trajectory.bodies.outline import Ground, Outline, ground_of, touches
from anchorflow_trajectory.bodies.wheels import BACKWARD, FORWARD, SLIDING, STANDING, Wheels
from anchorflow_trajectory.caching import cached_property
from anchorflow_trajectory.cost.clearance import GridField
from anchorflow_trajectory.cost.fields import Grid
from anchorflow_trajectory.scene import Scene

CELL_SHARE, LEAST_CELL, MOST_CELL = 0.3, 0.08, 1.0  # of a search: of the inner radius, and m
BETWEEN = 0.012  # m that the outline moves between two poses that are tested, from either
WINDOW, LEAST_WINDOW, MOST_WINDOW = 0.45, 0.1, 0.6  # of the average: in v_max / a_max, and s
MOVING = 0.02  # m/s
BRAKING = 0.7  # share of a_max
MOST_BEND = 2.0  # 1/m, that a robot which can turn on the spot begins with
RINGS, DIRECTIONS = (0.45, 0.9), np.arange(12) / 6.0  # of a tolerance, and in half turns
HEADINGS = np.array([0.0, 0.4, -0.4, 0.9, -0.9])  # of a tolerance


@dataclass(frozen=True)
class Body:
    """A robot's outline and wheels."""

    outline: Outline
    wheels: Wheels


@dataclass(frozen=True, eq=False)
class BodyScene:
    """A scene whose `robot_radius` is the outline's inner radius, and a body in it.

    tolerance: m and rad about the goal's place and heading within which a way may end if the
        outline does not fit there; None for the heading: any will do
    """

    scene: Scene
    body: Body
    tolerance: tuple[float, float | None]

    def classes(self, plane: FloatArray) -> list[object]:
        """Return a value for each path [N, T, 2], equal if they pass all on the same sides."""
        scene = self.scene
        if not len(scene.rays.rows):
            return [()] * len(plane)
        return [*scene.rays.signatures(plane, resolution=scene.resolution, origin=scene.origin)]

    @property
    def start(self) -> NDArray[np.float64]:
        """[3], the pose at the start."""
        return np.array(self.scene.x_curr[:3], np.float64)

    @property
    def heading_counts(self) -> bool:
        """Whether a way has to end in a heading."""
        return self.tolerance[1] is not None

    @cached_property
    def goal(self) -> NDArray[np.float64]:
        """[3], the goal, or the nearest pose within its tolerance at which the outline fits."""
        goal = np.array(self.scene.x_goal[:3], np.float64)
        within, turn = self.tolerance
        turns = HEADINGS[:1] if turn is None else HEADINGS * turn
        ring = np.stack([np.cos(np.pi * DIRECTIONS), np.sin(np.pi * DIRECTIONS)], 1)
        places = [np.zeros((1, 2)), *(share * within * ring for share in RINGS)]
        outline = self.body.outline.grown(BETWEEN)
        spans = np.empty((2, self.ground.room.shape[0]))
        for place in np.concatenate(places[: 1 + len(RINGS) * (within > 0.0)]):
            for aside in turns:
                pose = goal + np.array([*place, aside])
                headings = pose[2] + np.pi * DIRECTIONS if turn is None else pose[2:]
                for heading in headings:
                    tried = np.array([pose[0], pose[1], heading])
                    if not touches(self.ground, outline.corners, outline.reach, tried, spans):
                        return pose
        return goal

    def room_at(self, pose: FloatArray) -> float:
        """Return about m from the outline at a pose [3] to what is occupied, or the map's edge."""
        x, y = self.body.outline.rim(2.0 * self.scene.resolution).T
        cosine, sine = np.cos(pose[2]), np.sin(pose[2])
        points = np.stack([cosine * x - sine * y, sine * x + cosine * y], 1) + pose[:2]
        cells = ((points - self.scene.origin) / self.scene.resolution).astype(np.intp)
        height, width = self.ground.room.shape
        cells = np.clip(cells, 0, [width - 1, height - 1])
        return float(self.ground.room[cells[:, 1], cells[:, 0]].min())

    @property
    def first_speed(self) -> float:
        """m/s along the heading; a robot on wheels has no other. Who slides has it any way."""
        heading, velocity = self.scene.x_curr[2], self.scene.x_curr[3:5]
        if self.body.wheels.slides:
            return float(np.hypot(*velocity))
        return float(velocity[0] * np.cos(heading) + velocity[1] * np.sin(heading))

    @property
    def first_gear(self) -> int:
        """The gear in which the robot moves at the start."""
        if not self.moves:
            return STANDING
        if self.body.wheels.slides:
            return SLIDING
        return BACKWARD if self.first_speed < 0.0 else FORWARD

    @property
    def moves(self) -> bool:
        """Whether the robot moves at the start."""
        return abs(self.first_speed) > MOVING

    @property
    def lead(self) -> FloatArray:
        """[P, 3], poses that the robot keeps to at the start: who slides may brake on its course.

        Beyond braking the law looks ahead by half a window, and a spline rounds the corner.
        """
        if not (self.moves and self.body.wheels.slides):
            return self.start[None]
        rates = self.scene.x_curr[3:6] / self.first_speed
        length = self.braking + 0.5 * self.limits.window * self.limits.v_max + 2.0 * self.cell
        way = np.linspace(0.0, length, 2 + int(length / self.cell))
        return self.start + way[:, None] * rates

    @property
    def braking(self) -> float:
        """m in which the robot can stop at the start."""
        return 0.5 * self.first_speed**2 / (BRAKING * self.scene.motion.a_max)

    @property
    def first_bend(self) -> float:
        """rad/m that the robot turns at the start: of wheels, the curvature that they drive."""
        bend = float(self.scene.x_curr[5]) / abs(self.first_speed)
        radius = self.body.wheels.min_radius
        most = 1.0 / radius if radius > 0.0 else MOST_BEND
        return float(np.clip(bend, -most, most))

    def last_speed(self, course: float) -> float:
        """m/s at the goal, along a way whose last motion has this direction [rad]."""
        x, y = self.scene.x_goal[3:5]
        return max(float(x * np.cos(course) + y * np.sin(course)), 0.0)

    @property
    def cell(self) -> float:
        """m, a cell of a search."""
        return float(np.clip(CELL_SHARE * self.body.outline.inner, LEAST_CELL, MOST_CELL))

    @cached_property
    def limits(self) -> Limits:
        """What motions keep."""
        motion, wheels = self.scene.motion, self.body.wheels
        most_bend = 1.0 / wheels.min_radius if wheels.min_radius > 0.0 else np.inf
        window = float(np.clip(WINDOW * motion.v_max / motion.a_max, LEAST_WINDOW, MOST_WINDOW))
        return Limits(motion.v_max, motion.a_max, wheels.omega_max, most_bend, window)

    @cached_property
    def ground(self) -> Ground:
        """The map as outlines are tested on it."""
        scene = self.scene
        return ground_of(scene.occupied, scene.resolution, np.asarray(scene.origin))

    @cached_property
    def room(self) -> Grid:
        """m to the nearest occupied cell or the map's edge."""
        ground = self.ground
        return Grid.of(GridField(ground.room, ground.resolution, self.scene.origin), np.float64)

    @cached_property
    def dear(self) -> Grid:
        """m of detour that a metre is worth; empty if nothing is dear."""
        return Grid.of(self.scene.cost_fields.surcharge, np.float64)
