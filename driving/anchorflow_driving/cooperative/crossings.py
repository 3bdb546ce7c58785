"""Synthetic crossings: a house hides the crossing car from the ego, and a roadside camera sees it.

The ego drives towards a junction. If another car would be there at the same time, the ego brakes,
lets it pass and drives on; otherwise it keeps its speed, or follows a slow leader. A share of the
scenes has no house.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.cooperative.layout import CooperativeFrame
from anchorflow_driving.cooperative.painter import Block, frames, hidden, paint
from anchorflow_driving.geometry import Array, out_of_frame
from anchorflow_driving.sensors.pinhole import PinholeCamera
from anchorflow_driving.window import Vehicle

STEP_S = 0.1
FRAMES = 66
CAR = (4.6, 1.9)
STOP = 7.0
"""m from the junction's middle to the middle of the waiting ego's box."""
BRAKE, PULL = 2.5, 2.0  # m/s²
LANE = 3.5
HOUSE_COLOURS = ((150, 110, 90), (130, 130, 140), (170, 150, 120))
CAR_COLOURS = ((190, 40, 40), (40, 70, 180), (230, 230, 230), (30, 30, 35), (200, 170, 40))
ROAD = (78, 78, 82)
POLE = (34.0, -6.0, 8.0)
"""m: from here 30 m of the crossing road to either side are in the picture."""


@dataclass(frozen=True, eq=False)
class Crossing:
    """A drive through a crossing.

    occluded: [F] whether a house hides the crossing car from the ego
    shown: [F] whether the roadside picture shows the crossing car
    conflict: whether the ego has to give way
    junction: [3] pose of the junction's middle in the world; the ego drives along its x
    """

    frames: list[CooperativeFrame]
    occluded: NDArray[np.bool_]
    shown: NDArray[np.bool_]
    conflict: bool
    junction: Array


@dataclass(frozen=True)
class Setting:
    """The parameters of a scene in the junction's frame; the ego drives along x."""

    speed: float
    begin: float  # m before the junction's middle
    house: bool
    crosses: bool
    side: int  # of the crossing car: 1 left, -1 right
    other_speed: float
    other_time: float  # s, when it is at the junction
    leader: float | None  # m ahead of the ego


def draw_crossing(seed: int, *, size: tuple[int, int] = (384, 240), every: int = 4) -> Crossing:
    """Draw the scene of a seed; every n-th frame has pictures of `size` (width, height)."""
    rng = np.random.default_rng([seed, 7])
    setting = _draw_setting(rng)
    world = np.array([*rng.uniform(-500, 500, 2), rng.uniform(-np.pi, np.pi)])
    looks = {name: int(rng.integers(0, len(CAR_COLOURS))) for name in ("other", "leader")}
    house_colour = HOUSE_COLOURS[rng.integers(0, len(HOUSE_COLOURS))]
    house = _house(setting, rng)
    ego = _ego_path(setting)
    drive, occluded, shown = [], [], []
    pole = roadside_camera(size)
    for number in range(FRAMES):
        time = number * STEP_S
        others, colours = _others(setting, time, looks)
        houses = [Block(house, 8.0, house_colour)] if setting.house else []
        car = _camera((ego[number] + 1.5, -LANE / 2, 1.5), 0.0, 0.0, 0.57, size)
        unseen = setting.crosses and hidden(car, others[0, :2], houses)
        occluded.append(unseen)
        shown.append(
            setting.crosses
            and frames(pole, np.array([*others[0, :2], 1.0]))
            and not hidden(pole, others[0, :2], houses)
        )
        vehicle = infrastructure = None
        if number % every == 1 and number + 45 < FRAMES:
            blocks = [Block(box, 1.5, c) for box, c in zip(others, colours, strict=True)] + houses
            own = Block(np.array([ego[number], -LANE / 2, 0.0, *CAR]), 1.5, (60, 160, 90))
            vehicle = paint(car, _roads(), blocks)
            infrastructure = paint(pole, _roads(), [*blocks, own])
        axle = ego[number] - Vehicle(*CAR).rear_axle
        pose = out_of_frame(np.array([axle, -LANE / 2, 0.0]), world)
        placed = out_of_frame(others[:, :3], world)
        boxes = np.concatenate([placed, others[:, 3:]], 1)
        drive.append(CooperativeFrame(time, pose, vehicle, infrastructure, boxes))
    conflict = setting.crosses and _conflicts(setting)
    return Crossing(drive, np.array(occluded), np.array(shown), conflict, world)


def roadside_camera(size: tuple[int, int]) -> PinholeCamera:
    """Return the roadside camera, in the junction's frame; size: width, height of its picture."""
    return _camera(POLE, np.pi, -0.25, 0.55, size)


def _camera(
    place: tuple[float, float, float], yaw: float, pitch: float, focal: float, size: tuple[int, int]
) -> PinholeCamera:
    """focal: in widths of the picture"""
    width, height = size
    return PinholeCamera(place, yaw, pitch, focal * width, rows=height, columns=width)


def draw_crossings(scenes: int, *, seed: int = 0) -> Iterator[tuple[str, list[CooperativeFrame]]]:
    """Drives by name, for `write_recording`."""
    for number in range(scenes):
        yield str(number), draw_crossing(seed * 1_000_003 + number).frames


def _draw_setting(rng: np.random.Generator) -> Setting:
    # Short enough that the roadside camera sees the car that will meet the ego.
    speed, arrival = rng.uniform(6.0, 11.0), rng.uniform(2.4, 4.2)
    crosses = rng.random() < 0.7
    # Over half of the crossing cars arrive with the ego.
    early = rng.uniform(-1.0, 1.0) if rng.random() < 0.6 else rng.choice([-1, 1]) * 3.2
    return Setting(
        speed=speed,
        begin=speed * arrival,
        house=bool(rng.random() < 0.75),
        crosses=bool(crosses),
        side=int(rng.choice([-1, 1])),
        other_speed=rng.uniform(5.5, 7.5),
        other_time=arrival + early,
        leader=rng.uniform(16.0, 24.0) if not crosses and rng.random() < 0.4 else None,
    )


def _conflicts(setting: Setting) -> bool:
    return abs(setting.other_time - setting.begin / setting.speed) < 2.0


def _ego_path(setting: Setting) -> Array:
    """Return the x [F] of the middle of its box, 0 at the junction's middle."""
    position, speed = -setting.begin, setting.speed
    path = []
    for number in range(FRAMES):
        path.append(position)
        time = number * STEP_S
        wanted = _acceleration(setting, position, speed, time)
        speed = min(max(speed + STEP_S * wanted, 0.0), setting.speed)
        position += STEP_S * speed
    return np.array(path)


def _acceleration(setting: Setting, position: float, speed: float, time: float) -> float:
    if setting.crosses and _conflicts(setting) and time < setting.other_time + 0.9:
        left = -STOP - position
        if left > 0 and speed**2 / (2 * left) > 0.8 * BRAKE:
            return -(speed**2) / (2 * left)
        return 0.0
    if setting.leader is not None:
        gap = _leader_at(setting, time) - position - 8.0
        return float(np.clip(0.4 * gap + 0.9 * (0.6 * setting.speed - speed), -BRAKE, PULL))
    return PULL


def _leader_at(setting: Setting, time: float) -> float:
    assert setting.leader is not None
    return -setting.begin + setting.leader + 0.6 * setting.speed * time


def _others(setting: Setting, time: float, looks: dict[str, int]) -> tuple[Array, list]:
    boxes, colours = [], []
    if setting.crosses:
        along = setting.other_speed * (time - setting.other_time)
        lane = LANE / 2 if setting.side < 0 else -LANE / 2
        heading = -setting.side * np.pi / 2
        boxes.append([lane, -setting.side * along, heading, *CAR])
        colours.append(CAR_COLOURS[looks["other"]])
    if setting.leader is not None:
        boxes.append([_leader_at(setting, time), -LANE / 2, 0.0, *CAR])
        colours.append(CAR_COLOURS[looks["leader"]])
    return np.array(boxes).reshape(-1, 5), colours


def _house(setting: Setting, rng: np.random.Generator) -> Array:
    """Return a box [5] at the corner before the junction, on the side of the crossing car."""
    length, width = rng.uniform(14, 20), rng.uniform(14, 24)
    gap = 5.0
    return np.array([-gap - length / 2, setting.side * (gap + width / 2), 0.0, length, width])


def _roads() -> list[tuple[Array, tuple[int, int, int]]]:
    along = np.array([[-90.0, -LANE], [90.0, -LANE], [90.0, LANE], [-90.0, LANE]])
    return [(along, ROAD), (along[:, ::-1], ROAD)]
