"""Draw a robot's outline along an anchor, and where it turns round."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from anchorflow_client.contract import AnchorBatch
from anchorflow_trajectory.drawing import draw_outlines

FORWARDS, BACKWARDS, ON_SPOT, SIDEWAYS = "#1f4e9c", "#c25700", "#7a3ea1", "#1b7f5c"
EVERY_S, MOST_OUTLINES = 0.4, 30
STANDING, TURNING = 0.02, 0.05
"""m/s and rad/s, below which a robot stands."""

Floats = NDArray[np.floating]


def draw_body(axes: Axes, anchors: AnchorBatch, corners: Floats) -> None:
    """Draw an outline [K, 2] m along the best anchor, in colours of forwards and backwards.

    Diamonds are cusps, where the robot stops and drives the other way; rings are turns on the spot.
    """
    best = anchors.best
    poses, velocities = anchors.trajectories[best], anchors.velocities[best]
    lasts = float(anchors.durations[best])
    every = max(EVERY_S, lasts / MOST_OUTLINES)
    drawn, driven = outlines_at(poses, velocities, lasts, every=every)
    gears = gears_of(poses, velocities)
    words = {1: "forwards", -1: "backwards", 0: "on the spot", 2: "sideways"}
    for gear, colour in {1: FORWARDS, -1: BACKWARDS, 0: ON_SPOT, 2: SIDEWAYS}.items():
        chosen = driven == gear
        if not chosen.any():
            continue
        draw_outlines(axes, drawn[chosen], corners, edgecolors=colour, alpha=0.6, zorder=3)
        label = f"{words[gear]}, every {every:.1f} s"
        axes.plot([], [], "s", color=colour, fillstyle="none", markersize=10.0, label=label)
    _mark(axes, poses[cusps(gears)], "D", BACKWARDS, "cusp")
    _mark(axes, poses[turns(gears)], "o", ON_SPOT, "turn on the spot")


def outlines_at(
    poses: Floats, velocities: Floats, lasts: float, *, every: float
) -> tuple[Floats, NDArray[np.int64]]:
    """Return the poses [K, 3] `every` s along an anchor and at its end, and their gears [K]."""
    times = np.linspace(0.0, lasts, len(poses))
    at = np.arange(0.0, lasts + every, every).clip(max=lasts)
    nearest = np.abs(times - at[:, None]).argmin(1)
    drawn = np.stack([np.interp(at, times, part) for part in poses.T], 1)
    return drawn, gears_of(poses, velocities)[nearest]


def gears_of(poses: Floats, velocities: Floats) -> NDArray[np.int64]:
    """Return the gear at each of poses [T, 3].

    It is 1 forwards, -1 backwards, 0 for a turn on the spot, and 2 if it is rather sideways.

    A robot at rest is in the gear in which it drives on, or has arrived.
    """
    heading = poses[:, 2]
    along = velocities[:, 0] * np.cos(heading) + velocities[:, 1] * np.sin(heading)
    speed = np.hypot(velocities[:, 0], velocities[:, 1])
    turns = (speed <= STANDING) & (np.abs(velocities[:, 2]) > TURNING)
    known = np.flatnonzero((speed > STANDING) | turns)
    if not known.size:
        return np.ones(len(poses), np.int64)
    following = np.searchsorted(known, np.arange(len(poses))).clip(max=len(known) - 1)
    slides = np.sqrt(0.5) * speed > np.abs(along)
    gears = np.where(slides, 2, np.sign(along).astype(np.int64)) * ~turns
    return gears[known[following]]


def cusps(gears: NDArray[np.int64]) -> NDArray[np.intp]:
    """Return the last steps before a robot drives the other way."""
    return np.flatnonzero(gears[:-1] * gears[1:] == -1)


def turns(gears: NDArray[np.int64]) -> NDArray[np.intp]:
    """Return the first steps of turns on the spot."""
    return np.flatnonzero((gears == 0) & (np.roll(gears, 1) != 0))


def _mark(axes: Axes, places: Floats, marker: str, colour: str, name: str) -> None:
    if len(places):
        look = {"color": colour, "markersize": 8.0, "linestyle": "none", "zorder": 6}
        axes.plot(*places[:, :2].T, marker, markeredgecolor="white", label=name, **look)
