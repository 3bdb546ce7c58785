"""A simulated log: a net, traffic on it, and the windows that a planner is asked about."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from anchorflow_driving.errors import SimulationError
from anchorflow_driving.geometry import Array
from anchorflow_driving.log import (
    FRAME_S,
    FUTURE_FRAMES,
    HISTORY_FRAMES,
    NO_WINDOWS,
    PEDESTRIAN,
    SIMULATED,
    DrivingLog,
    Lane,
    RoadMap,
    track_fields,
)
from anchorflow_driving.simulation import LogConfig
from anchorflow_driving.simulation.demand import make_demand
from anchorflow_driving.simulation.road_net import RoadNet
from anchorflow_driving.simulation.roadside import all_that_stands, roadside
from anchorflow_driving.simulation.routes import followed_line
from anchorflow_driving.simulation.street_plan import ARTERIAL, QUARTER, make_net
from anchorflow_driving.simulation.sumo_traffic import (
    PERSON_SIZE,
    Recording,
    VehicleRecord,
    as_array,
    record,
)
from anchorflow_driving.simulation.vehicle_motion import deviating, person_states, vehicle_states
from anchorflow_driving.window_choice import Driven, choose_windows

ATTEMPTS = 5
"""Draws of a log before it is taken as it is."""
LEAST_FRAMES = 3
"""Least frames of a track; shorter ones are dropped."""
AFTER = 10
"""Frames simulated past the log's end, so that smoothing knows how its motions go on."""


Track = tuple[int, tuple[float, float], Array]
"""Kind, size and states [F, 5]."""


def simulate_log(config: LogConfig, index: int) -> tuple[DrivingLog, Counter[str]]:
    """Log `index` of a seed, and what was counted: windows, what was dropped and redrawn.

    Raises `SimulationError` if SUMO did not run in any of ATTEMPTS draws.
    """
    redrawn: Counter[str] = Counter()
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([config.seed, index, attempt])
        try:
            log, counts = _simulated(config, f"simulated-{config.seed}-{index:05d}", rng)
        except SimulationError:
            if attempt == ATTEMPTS - 1:
                raise
            redrawn["redrawn: SUMO failed"] += 1
            continue
        if log.windows >= config.windows / 4 or attempt == ATTEMPTS - 1:
            return log, counts + redrawn
        redrawn["redrawn: few windows"] += 1
    raise AssertionError("the last attempt returns or raises")


def _simulated(
    config: LogConfig, name: str, rng: np.random.Generator
) -> tuple[DrivingLog, Counter[str]]:
    warm_up_s = float(rng.uniform(12.0, 35.0))
    begin, frames = round(warm_up_s / FRAME_S), round(config.seconds / FRAME_S)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        arterial = config.arterial > 0 and rng.random() < config.arterial
        path = make_net(rng, folder, medians=True, kind=ARTERIAL if arterial else QUARTER)
        net = RoadNet(path)
        demand = make_demand(net, rng, folder, warm_up_s=warm_up_s, seconds=config.seconds)
        seed = int(rng.integers(2**31))
        recording = record(path, demand, seed=seed, frames=begin + frames + AFTER)
    deviate = config.deviating > 0 and rng.random() < config.deviating
    tracks, driven = _tracks(
        recording, net, begin=begin, frames=frames, deviations=rng if deviate else None
    )
    level = float(rng.uniform(0.1, 0.38))
    beside = roadside(net, rng, level=level)
    for each in [*all_that_stands(net, rng), *beside.standing]:
        tracks.append((each.kind, each.size, np.repeat(each.state[None], frames, axis=0)))
    mirror = -1.0 if rng.random() < config.left_hand else 1.0
    fields = net_fields(net, level=level, mirror=mirror, also=beside.areas)
    kind, size, states = zip(*tracks, strict=True)
    fields |= track_fields(kind, size, np.stack(states) * [1.0, mirror, mirror, 1.0, mirror])
    for each in driven:
        each.line[:, 1] *= mirror
    log = DrivingLog(
        name=name,
        source=SIMULATED,
        licence="none",
        city="left-hand traffic" if mirror < 0 else "right-hand traffic",
        dt=FRAME_S,
        **fields,
        **NO_WINDOWS,
    )
    if not config.speed_limits:
        driven = [
            replace(each, speed_limit=np.full_like(each.speed_limit, np.nan)) for each in driven
        ]
    return choose_windows(log, driven, rng, most=config.windows)


def _tracks(
    recording: Recording,
    net: RoadNet,
    *,
    begin: int,
    frames: int,
    deviations: np.random.Generator | None,
) -> tuple[list[Track], list[Driven]]:
    """Tracks of the frames from `begin`, and the lines that the vehicles among them followed.

    deviations: draws deviations from those lines; None for none
    """
    tracks: list[Track] = []
    driven: list[Driven] = []
    for vehicle in recording.vehicles:
        front, asked = as_array(vehicle.front), np.ones(len(vehicle.front), bool)
        if deviations is not None:
            front, asked = deviating(front, deviations, first=vehicle.first - begin)
        states = vehicle_states(front, vehicle.size[0])
        cut = _cut(states, vehicle.first, begin=begin, frames=frames)
        seen = int(np.isfinite(cut[:, 0]).sum())
        if seen > HISTORY_FRAMES + FUTURE_FRAMES:
            course = _driven(len(tracks), vehicle, net, begin=begin, frames=frames)
            column = asked[:, None].astype(float)
            wanted = _cut(column, vehicle.first, begin=begin, frames=frames)[:, 0] == 1
            driven.append(replace(course, asked=wanted))
        if seen >= LEAST_FRAMES:
            tracks.append((vehicle.kind, vehicle.size, cut))
    for person in recording.people:
        states = person_states(as_array(person.place))
        cut = _cut(states, person.first, begin=begin, frames=frames)
        if np.isfinite(cut[:, 0]).sum() >= LEAST_FRAMES:
            tracks.append((PEDESTRIAN, PERSON_SIZE, cut))
    return tracks, driven


def _driven(track: int, vehicle: VehicleRecord, net: RoadNet, *, begin: int, frames: int) -> Driven:
    line, place = followed_line(net, vehicle)
    limits = [net.lanes[name].speed if name in net.lanes else np.nan for name, _ in vehicle.lane]
    known = _cut(np.column_stack([place, limits]), vehicle.first, begin=begin, frames=frames)
    middle = known[:, 0] - vehicle.size[0] / 2
    return Driven(track, vehicle.kind, line, middle, known[:, 1])


def _cut(values: Array, first: int, *, begin: int, frames: int) -> Array:
    """The frames from `begin` of values [F, ...] that start at frame `first`; NaN elsewhere."""
    held = np.full((frames, values.shape[1]), np.nan)
    start, end = max(first, begin), min(first + len(values), begin + frames)
    if start < end:
        held[start - begin : end - begin] = values[start - first : end - first]
    return held


def net_fields(
    net: RoadNet, *, level: float, mirror: float, also: Sequence[Array] = ()
) -> dict[str, Any]:
    """Fields of a log's map; level and also: as `drivable_rings` takes them."""
    lanes = [
        Lane(each.name, each.polygon, each.centre, net.following[each.name], each.in_junction)
        for each in net.lanes.values()
    ]
    drivable = net.drivable_rings(level=level, also=also)
    return RoadMap(lanes, drivable, net.crossings, list(net.lines())).fields(mirror=mirror)
