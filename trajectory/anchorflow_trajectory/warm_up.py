"""Everything that is compiled, run once: a process that serves keeps nobody waiting for it.

    python -m anchorflow_trajectory.warm_up

compiles what a later process then finds on disk.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from anchorflow_trajectory.compiled import kept
from anchorflow_trajectory.finish.bisection import bisect_to_safe
from anchorflow_trajectory.finish.certificate import are_safe
from anchorflow_trajectory.finish.refiner import Refiner
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.movers import MovingDiscs
from anchorflow_trajectory.ode.integrate import drawn
from anchorflow_trajectory.routes.reachable import connected
from anchorflow_trajectory.scene import Scene

logger = logging.getLogger(__name__)

CELLS, RESOLUTION = 32, 0.2  # of a map of 6.4 m
POST = slice(14, 18)


@dataclass(frozen=True)
class _Everything:
    """All that can be asked of a finish."""

    smooth: bool = True
    project: bool = True
    safety_margin: float = 0.1
    barrier: bool = True
    certified_margin: float = 0.0


@cache
def compile_loops() -> None:
    """Run them on a small scene: its routes, its finish, and a bisection.

    A second or less where they are found on disk, else up to two minutes of processor time.
    """
    if not kept():
        logger.warning("compiling loops for this processor, once: up to two minutes")
    cost_map = np.zeros((3, CELLS, CELLS), np.float32)
    cost_map[0, POST, POST], cost_map[1], cost_map[2, :4] = 1.0, 1.0, 0.5
    scene = Scene(
        cost_map=cost_map,
        resolution=RESOLUTION,
        origin=np.zeros(2),
        robot_radius=0.25,
        x_curr=np.array([0.8, 3.2, 0.3, 0.0, 0.0, 0.0]),
        x_goal=np.array([5.6, 3.2, 0.0, 0.0]),
        w_style=np.array([0.4, 0.3, 0.3]),
        motion=MotionLimits(v_max=2.0, a_max=3.0),
    )
    drawn(np.zeros((1, 1), np.float32), np.zeros((1, 1), np.float32))
    connected(scene.occupied, 0)
    routes = scene.route_splines
    Refiner(scene, steps=1).refine(scene.route_states, np.arange(len(routes)), _Everything())
    crossing = MovingDiscs.of(np.array([[3.0, 5.0]]), np.array([[0.0, -1.0]]), np.array([0.3]))
    busy = replace(scene, movers=crossing).among_movers()
    ways = busy.ways.route
    Refiner(busy, steps=1).refine(busy.route_states, np.arange(len(ways)), _Everything())
    pair = routes[np.zeros(2, np.intp)]
    safe, route, clearance = (
        np.array([True, False]),
        np.zeros(2, np.intp),
        scene.cost_fields.clearance,
    )
    bisect_to_safe(pair, safe, scene.ends, scene.basis, clearance, scene.motion, route=route)
    are_safe(pair, scene.basis, clearance, scene.motion)


if __name__ == "__main__":
    compile_loops()
