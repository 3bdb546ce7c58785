"""Where anchors end: the goal, or where it moves if something is in its way or time is short."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from anchorflow_trajectory import FloatArray
from anchorflow_trajectory.motion import GENTLE, nominal_duration
from anchorflow_trajectory.routes.passing import WAITS, place_to_end
from anchorflow_trajectory.routes.search import place_along
from anchorflow_trajectory.routes.splines import splines_through
from anchorflow_trajectory.scene import CLOSE, HURRY, Scene
from anchorflow_trajectory.spline.basis import Splines

LOOK_AHEAD = 40  # cells beyond a moved goal that are looked at for walls
TINY = 1e-9  # m/s


def among_movers(scene: Scene) -> Scene:
    """Return the scene with a goal at which anchors can end, where something moves.

    A goal that cannot be reached within the horizon moves back along the cheapest route, one on
    which something that moves will be on arrival to the nearest place that is clear then.
    """
    if scene.movers is None:
        return scene
    start, goal, dim = scene.x_curr[:2], scene.x_goal[:2], len(scene.x_goal) // 2
    velocity, goal_velocity = scene.x_curr[dim : dim + 2], scene.x_goal[dim : dim + 2]
    horizon, motion, route = scene.motion.horizon_s, scene.motion, scene.cheapest
    about, within, is_late = start, np.inf, False
    if horizon is None:
        aside, usual = goal_velocity, nominal_duration(scene.shortest_way, motion)
        times = [usual, *(usual + wait for wait in WAITS)]
    else:
        times, begin = [horizon], float(np.linalg.norm(velocity))
        asked = float(np.linalg.norm(goal_velocity))
        if motion.most_way(horizon, begin, asked) < route.length:
            speed = motion.speed_at(route.length + asked**2 / motion.a_max, horizon, begin)
            reach, is_late = motion.most_way(horizon, begin, speed, is_late=True), True
            goal, ahead = place_along(route.points, reach)
            goal_velocity = speed * ahead
        slowest = velocity * (motion.least_speed(horizon, begin) / max(begin, TINY))
        aside = goal_velocity if goal_velocity.any() else slowest
        about = start + 0.5 * horizon * (velocity + aside)
        within = motion.most_way(horizon, 0.0)
    place = place_to_end(
        goal, start, scene.cost_fields, times, goal_velocity, about=about, within=within
    )
    if np.array_equal(place, scene.x_goal[:2]):
        return scene
    if place is not goal:
        goal_velocity = aside
    x_goal = scene.x_goal.copy()
    x_goal[:2], x_goal[dim : dim + 2] = place, goal_velocity
    return replace(scene, x_goal=x_goal, is_late=is_late)


def ending_at(scene: Scene, place: FloatArray) -> Scene:
    """Return the scene with a goal [2] elsewhere, whose velocity leads on along the way there.

    It is no faster than who stops before the walls ahead can be.
    """
    dim, x_goal = len(scene.x_goal) // 2, scene.x_goal.copy()
    x_goal[:2] = place
    moved = replace(scene, x_goal=x_goal)
    speed = float(np.linalg.norm(x_goal[dim : dim + 2]))
    if speed > 0.0:
        route = moved.cheapest
        _, ahead = place_along(route.points, route.length)
        at = place + np.arange(LOOK_AHEAD)[:, None] * scene.resolution * ahead
        free = scene.cost_fields.clearance.sample(*at.astype(np.float32).T) >= 0.0
        room = scene.resolution * (LOOK_AHEAD if free.all() else int(free.argmin()))
        x_goal[dim : dim + 2] = min(speed, (GENTLE * scene.motion.a_max * 2 * room) ** 0.5) * ahead
    return replace(scene, x_goal=x_goal)


def in_time(scene: Scene, hurry: float, room: float) -> tuple[Scene, Splines] | None:
    """Return the scene with the end nearest to the goal that can be reached in time, and ways.

    They are the cheapest over places and times, whatever the velocity at their end; None where
    there is none.

    hurry: share of v_max that they reach
    room: m that they keep from what moves
    """
    swept = (hurry, room) == (HURRY, CLOSE)
    lattice, motion = scene.hurried if swept else scene.space_time(hurry, room)
    if (end := lattice.nearest_end(scene.x_goal[:2])) is None:
        return None
    places, velocity = lattice.ways_to(end, scene.basis.num_samples)
    dim, x_goal = len(scene.x_goal) // 2, scene.x_goal.copy()
    x_goal[:2], x_goal[dim : dim + 2] = places[0, -1], velocity
    nearer = replace(scene, x_goal=x_goal, motion=motion)
    lasting = np.full(len(places), motion.horizon_s)
    return nearer, splines_through(places, scene.basis, nearer.ends, lasting)
