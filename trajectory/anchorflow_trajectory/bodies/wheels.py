"""Wheels: how a robot moves, and the short motions that a search of poses is made of."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FORWARD, BACKWARD, TURNING, STANDING, SLIDING = 1, -1, 0, 2, 3
"""Gears; a robot that stands may take any, and one that slides drives any way at any heading."""
STEP = 1.8  # cells of a search that a short motion covers
LOOKS = 3  # poses of a short motion at which it is tested
SOFT_TURN, HARD_TURN = 0.17, 0.36  # rad of heading in a short motion
BIN = 0.06  # rad, within which headings count as one: less than turns differ by
STOP = 0.4  # s that a stop costs beside the time to brake and to speed up
BACKWARDS = 1.5  # times what a way costs forwards
BEND = 0.04  # of its length that a bend of one rad costs more
SLIDES = 8  # directions in which a robot slides


@dataclass(frozen=True)
class Wheels:
    """What wheels allow.

    omega_max: rad/s; min_radius: m of the tightest turn while driving, 0 if it has none
    reverse: whether it may drive backwards; spot: whether it can turn on the spot
    slides: whether it drives any way, whatever its heading
    """

    omega_max: float
    min_radius: float = 0.0
    reverse: bool = False
    spot: bool = True
    slides: bool = False


class Moves(NamedTuple):
    """Short motions from the pose (0, 0, 0).

    poses: [M, LOOKS, 3] that each passes, the last its end; gears: [M]; lengths: [M] m
    costs: [M] m; stop: m, what a change of gear costs; spin: m, what a rad on the spot costs
    radius: m of the turns to a goal
    bins: headings that a search tells apart
    forward: the gear in which the robot drives forwards, -1 in a search from the goal back
    """

    poses: NDArray[np.float64]
    gears: NDArray[np.int64]
    lengths: NDArray[np.float64]
    costs: NDArray[np.float64]
    stop: float
    spin: float
    radius: float
    reverse: bool
    spot: bool
    slides: bool
    bins: int
    forward: int


@lru_cache(maxsize=64)
def moves_of(
    wheels: Wheels,
    *,
    cell: float,
    v_max: float,
    a_max: float,
    spare: float = 1.0,
    back: bool = False,
) -> Moves:
    """Return the short motions for a search with cells of `cell` m.

    spare: factor on the radius of the tightest turn
    back: whether the search starts at the goal; each gear is then that of the reversed motion
    """
    step = STEP * cell
    softest, hardest = SOFT_TURN / step, HARD_TURN / step
    if wheels.min_radius > 0.0:
        hardest = min(hardest, 1.0 / (spare * wheels.min_radius))
        softest = min(softest, 0.5 * hardest)
    found: list[tuple[NDArray[np.float64], int, float, float]] = []
    shares = np.arange(1, LOOKS + 1) / LOOKS
    if wheels.slides:
        found += [
            _slide(step * shares, 2.0 * np.pi * k / SLIDES, turn)
            for k in range(SLIDES)
            for turn in (0.0, SOFT_TURN, -SOFT_TURN)
        ]
    forward = BACKWARD if back else FORWARD
    driven = (forward, -forward) if wheels.reverse else (forward,)
    for gear in () if wheels.slides else driven:
        for bend in (0.0, softest, -softest, hardest, -hardest):
            way = gear * step * shares
            cost = step * (1.0 if gear == forward else BACKWARDS) + BEND * abs(bend) * step
            found.append((arc(way, bend), gear, step, cost))
    if wheels.spot:
        for turn in (SOFT_TURN, -SOFT_TURN):
            poses = np.stack([0.0 * shares, 0.0 * shares, turn * shares], 1)
            found.append((poses, TURNING, 0.0, SOFT_TURN * v_max / wheels.omega_max))
    poses, gears, lengths, costs = zip(*found, strict=True)
    radius = spare * wheels.min_radius if wheels.min_radius > 0.0 else 1.0 / hardest
    return Moves(
        np.stack(poses),
        np.array(gears),
        np.array(lengths),
        np.array(costs),
        v_max * (STOP + 0.5 * v_max / a_max),
        v_max / wheels.omega_max,
        radius,
        wheels.reverse,
        wheels.spot,
        wheels.slides,
        round(2.0 * np.pi / BIN),
        forward,
    )


def _slide(
    way: NDArray[np.float64], along: float, turn: float
) -> tuple[NDArray[np.float64], int, float, float]:
    """Return the poses [K, 3] of a slide in a direction, its gear, length [m] and cost [m]."""
    step = float(way[-1])
    poses = np.stack([way * np.cos(along), way * np.sin(along), turn * way / step], 1)
    return poses, SLIDING, step, step + BEND * abs(turn)


def arc(way: NDArray[np.float64], bend: float) -> NDArray[np.float64]:
    """Return poses [K, 3] after signed ways [K] in m along a circle of curvature `bend` [1/m]."""
    angle = way * bend
    chord = way * np.sinc(angle / (2.0 * np.pi))
    return np.stack([chord * np.cos(angle / 2.0), chord * np.sin(angle / 2.0), angle], 1)
