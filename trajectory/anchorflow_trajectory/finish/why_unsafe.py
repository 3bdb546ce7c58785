"""Say in one sentence why none of a scene's anchors is safe.

The causes are tried in turn, the certain ones first; nothing is computed before it is asked for.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from anchorflow_trajectory import BoolArray, FloatArray
from anchorflow_trajectory.finish.certificate import (
    ACCELERATION_TOLERANCE,
    SHARE_OF_CELL,
    SPEED_TOLERANCE,
    required_clearance,
)
from anchorflow_trajectory.motion import GENTLE
from anchorflow_trajectory.routes.dijkstra import cell_index
from anchorflow_trajectory.routes.reachable import connected
from anchorflow_trajectory.routes.search import free_cells
from anchorflow_trajectory.scene import Scene

HALVINGS = 12  # of the widths between which the widest gap lies
LOOK = 0.05  # m between two points of a braking distance
HELP = {
    "start": "clear_start frees the cells under the robot",
    "goal": "with goal_tolerance anchors may end beside it",
}
LARGER_MAP = "both ends reach the edge of the map, so a larger one may show another way"


def why_unsafe(scene: Scene, clearance: FloatArray, *, certified_margin: float) -> str:
    """Return the likeliest cause.

    clearance: [N] m beyond robot_radius of its anchors; certified_margin: m that they had to keep
    """
    cause = next(_causes(scene, certified_margin), None)
    cause = cause or _widest(scene, float(clearance.max()), certified_margin)
    return f"none of {len(clearance)} anchors is safe: {cause}"


def _causes(scene: Scene, margin: float) -> Iterator[str]:
    dim = len(scene.x_goal) // 2
    for name, state in (("start", scene.x_curr), ("goal", scene.x_goal)):
        yield from _too_near(scene, name, state[:2], margin)
    for name, state in (("start", scene.x_curr), ("goal", scene.x_goal)):
        yield from _too_fast(scene, name, state[dim:], dim)
    yield from _no_way(scene, margin)
    yield from _too_long(scene)
    yield from _cannot_stop(scene, margin)


def _too_near(scene: Scene, name: str, place: FloatArray, margin: float) -> Iterator[str]:
    """Find an end that is too near to an obstacle, or to the map's edge."""
    field, radius = scene.cost_fields.clearance, scene.robot_radius
    room = float(field.sample(*place.astype(np.float32)))
    share = SHARE_OF_CELL * field.resolution
    if room < 0.0:
        apart = max(radius + room, 0.0)
        yield (
            f"the {name} is {apart:.3f} m from an obstacle, and robot_radius is {radius:g} m; "
            f"{HELP[name]}"
        )
    elif room < margin + share:
        yield (
            f"the {name} keeps {room:.3f} m of the {margin:.3f} m that are asked for and "
            f"{share:.3f} m for the width of a cell"
        )


def _too_fast(scene: Scene, name: str, rates: FloatArray, dim: int) -> Iterator[str]:
    """Find a velocity, or the start's acceleration, beyond its limit; rates: [D] or [2D]."""
    speed, motion = float(np.linalg.norm(rates[:2])), scene.motion
    if speed > SPEED_TOLERANCE * motion.v_max:
        yield f"the {name} moves at {speed:.2f} m/s, and v_max is {motion.v_max:g} m/s"
    pull = float(np.linalg.norm(rates[dim : dim + 2]))
    if pull > ACCELERATION_TOLERANCE * motion.a_max:
        yield f"the {name} accelerates by {pull:.2f} m/s^2, and a_max is {motion.a_max:g} m/s^2"


def _no_way(scene: Scene, margin: float) -> Iterator[str]:
    """Find that obstacles enclose an end, or that every gap is too narrow."""
    needed = required_clearance(scene.cost_fields.clearance, margin)
    if (parts := _parts(scene, needed)) is None:
        return
    radius, beyond = scene.robot_radius, f"; {LARGER_MAP}" if _all_reach_edge(parts) else ""
    low, high = -radius, needed
    if (lost := _parts(scene, low)) is not None:
        enclosed = "goal" if _all_reach_edge(lost[:1]) else "start"
        how = f"part them; {LARGER_MAP}" if _all_reach_edge(lost) else f"enclose the {enclosed}"
        yield f"no way leads from the start to the goal: obstacles {how}"
        return
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _parts(scene, middle) is None else (low, middle)
    widest, wide = 2.0 * (radius + low), 2.0 * (radius + needed)
    yield (
        f"every gap is too narrow: the widest is about {widest:.2f} m, {wide - widest:.2f} m less "
        f"than the {wide:.2f} m that are needed{beyond}"
    )


def _parts(scene: Scene, slack: float) -> tuple[BoolArray, BoolArray] | None:
    """Return the cells [H, W] that each end reaches with that clearance; None if they meet."""
    clearance = scene.clearance_field
    ends = [
        cell_index(state[:2], scene.origin, scene.resolution, clearance.shape)
        for state in (scene.x_curr, scene.x_goal)
    ]
    free = np.ascontiguousarray(free_cells(clearance, ends, slack=slack))
    reached = connected(free, ends[0])
    return None if reached.flat[ends[1]] else (reached, connected(free, ends[1]))


def _all_reach_edge(parts: Sequence[BoolArray]) -> bool:
    return all(cells[[0, -1]].any() or cells[:, [0, -1]].any() for cells in parts)


def _too_long(scene: Scene) -> Iterator[str]:
    """Find that the horizon ends before the shortest way does."""
    motion, dim = scene.motion, len(scene.x_goal) // 2
    if motion.horizon_s is None or not scene.routes:
        return
    begin, end = (float(np.linalg.norm(s[dim : dim + 2])) for s in (scene.x_curr, scene.x_goal))
    length = min(route.length for route in scene.routes)
    most = min(motion.v_max * motion.horizon_s, motion.most_way(motion.horizon_s, begin, end))
    if length > most:
        yield (
            f"the shortest way is {length:.1f} m, and a robot of {motion.v_max:g} m/s gets "
            f"{most:.1f} m far in horizon_s = {motion.horizon_s:g} s"
        )


def _cannot_stop(scene: Scene, margin: float) -> Iterator[str]:
    """Find an obstacle within the braking distance straight ahead."""
    dim, motion, field = len(scene.x_goal) // 2, scene.motion, scene.cost_fields.clearance
    velocity = scene.x_curr[dim : dim + 2]
    speed = float(np.linalg.norm(velocity))
    braking = speed**2 / (2.0 * GENTLE * motion.a_max)
    ahead = np.arange(0.0, braking, LOOK)
    if not len(ahead):
        return
    places = scene.x_curr[:2] + ahead[:, None] * (velocity / speed)
    hit = field.sample(*places.T.astype(np.float32)) < required_clearance(field, margin)
    if hit.any():
        yield (
            f"the start is too fast: from {speed:.2f} m/s it takes {braking:.2f} m to stop "
            f"smoothly, and there is room for {ahead[hit.argmax()]:.2f} m"
        )


def _widest(scene: Scene, widest: float, margin: float) -> str:
    """Say how near the anchors come."""
    if widest >= margin:
        return "those that have room break a limit or keep the margin only just"
    what = (
        "what moves and what stands leave" if scene.movers is not None else "the widest way keeps"
    )
    return f"{what} {widest:.3f} m of the {margin:.3f} m that are asked for"
