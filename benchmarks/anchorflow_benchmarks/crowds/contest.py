"""A contest among people: anchors with tracks or painted people, MPPI, a line.

Run by `anchorflow bench crowds`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Annotated

import numpy as np
import typer

from anchorflow_benchmarks import BenchmarkError, options
from anchorflow_benchmarks.crowds.drivers import (
    A_MAX,
    V_MAX,
    AnchorDriver,
    Driver,
    MppiDriver,
    StraightDriver,
    braked,
)
from anchorflow_benchmarks.crowds.worlds import (
    CONTACT,
    RADIUS,
    TICK_S,
    TOLERANCE,
    Array,
    World,
    read_recordings,
)
from anchorflow_benchmarks.planners import bundle_names, open_bundle
from anchorflow_benchmarks.quality import mean_of
from anchorflow_benchmarks.report import ResultTable, Row, progress, report
from anchorflow_cli.extras import needs_extra
from anchorflow_service.bundle import Bundle
from anchorflow_service.engine import Engine

ROBOTS = ("double-integrator", "unicycle")
TURN_MAX = 2.0  # rad/s of the unicycle
ROOMS, SEEDS = 100, 3
ANCHORS = {"tracks": "with tracks", "discs": "with painted discs"}
DRIVERS = (*ANCHORS, "mppi", "straight")
CFM_MPPI = "cfm-mppi"
"""Beside the drivers of a run by default: it trains first."""


@dataclass(frozen=True)
class Trip:
    """contacts, faults: people touched, and those that the robot moved into; hit: touched a wall

    short: m to the goal at the end; nearest: m to any person at least; jerk: m/s^3, root mean
    square; ms: of a decision, median; braked: share of the ticks without a plan
    """

    contacts: int
    faults: int
    hit: bool
    short: float
    time_s: float
    nearest: float
    jerk: float
    ms: float
    braked: float


def drive(world: World, driver: Driver, *, robot: str) -> Trip:
    """Drive once from rest; without a time to be there a run also ends at a wall or a fault."""
    world.begin()
    driver.begin(world.seed)
    state, way, hit = np.concatenate([world.start, np.zeros(4)]), world.goal - world.start, False
    short = np.inf
    heading, states = float(np.arctan2(way[1], way[0])), [state]
    spent, distances, faults, braking = [], [], 0, 0
    near = np.zeros(len(world.positions), bool)
    contacts = np.zeros(len(near), int)
    for _ in range(world.ticks):
        began = perf_counter()
        wanted = driver.step(world, state)
        spent.append(1e3 * (perf_counter() - began))
        braking += wanted is None
        wanted = braked(state) if wanted is None else wanted
        if robot == "unicycle":
            wanted, heading = steered(state, heading, wanted)
        states.append(state := wanted)
        world.advance(state)

        distance = np.linalg.norm(world.positions - state[:2], axis=-1)
        distances.append(np.nanmin(distance, initial=np.inf))
        new, near = (distance < CONTACT) & ~near, distance < CONTACT
        contacts += new
        faults += int((new & _moves_into(state, world)).sum())
        hit |= bool(world.wall_distance(state[:2]) < RADIUS)
        short = float(np.hypot(*(world.goal - state[:2])))
        if world.left_s is None and (short <= TOLERANCE or hit or faults):
            break
    jerk = np.diff(np.array(states)[:, 2:4], 2, axis=0) / TICK_S**2
    return Trip(
        contacts=int(contacts.sum()),
        faults=faults,
        hit=hit,
        short=short,
        time_s=TICK_S * len(spent),
        nearest=float(min(distances)),
        jerk=float(np.sqrt(mean_of((jerk**2).sum(1)))),
        ms=float(np.median(spent)),
        braked=braking / len(spent),
    )


def _moves_into(state: Array, world: World) -> Array:
    """Return [M] whether the robot is faster towards a person than the person towards it."""
    towards = world.positions - state[:2]
    return (towards * (state[2:4] + world.velocities)).sum(1) > 0.0


def steered(state: Array, heading: float, wanted: Array) -> tuple[Array, float]:
    """Return a unicycle's next state [6] and heading on the way to a wanted state."""
    speed = float(np.hypot(*wanted[2:4]))
    course = wanted[2:4] if speed > 0.05 else wanted[:2] - state[:2]
    off = float(np.arctan2(course[1], course[0])) - heading if np.hypot(*course) > 1e-3 else 0.0
    off = (off + np.pi) % (2 * np.pi) - np.pi
    heading += float(np.clip(off, -TURN_MAX * TICK_S, TURN_MAX * TICK_S))
    fastest = min(V_MAX, float(np.hypot(*state[2:4])) + A_MAX * TICK_S)
    speed = min(speed * max(np.cos(off), 0.0), fastest)
    velocity = speed * np.array([np.cos(heading), np.sin(heading)])
    change = (velocity - state[2:4]) / TICK_S
    return np.concatenate([state[:2] + TICK_S * velocity, velocity, change]), heading


def row_of(driver: str, trips: Sequence[Trip]) -> Row:
    """Return a driver's figures; `docs/benchmarks.md` says what they are."""
    columns = {name: np.array([getattr(trip, name) for trip in trips]) for name in vars(trips[0])}
    collided, arrived = columns["contacts"] > 0, columns["short"] <= TOLERANCE
    success = arrived & ~collided & ~columns["hit"]
    return {
        "driver": driver,
        "runs": len(trips),
        "collided": float(collided.mean()),
        "at fault": float((columns["faults"] > 0).mean()),
        "hit": float(columns["hit"].mean()),
        "arrived": float(arrived.mean()),
        "success": float(success.mean()),
        "short": float(columns["short"].mean()),
        "time s": mean_of(columns["time_s"][arrived]),
        **{name: float(np.median(columns[name])) for name in ("nearest", "jerk", "ms")},
        "braked": float(columns["braked"].mean()),
    }


def drivers_of(
    names: Sequence[str], bundles: Sequence[Bundle], *, num: int, pace: bool, threads: int | None
) -> list[Driver]:
    """Return the drivers with these names, those of anchors for each bundle.

    Raises `BenchmarkError` if a name is unknown.
    """
    known = (*DRIVERS, CFM_MPPI)
    if unknown := [name for name in names if name not in known]:
        raise BenchmarkError(f"--drivers: expected some of {', '.join(known)}, got {unknown[0]}")
    kinds = [name for name in ANCHORS if name in names]
    engines = [Engine(bundle, threads=threads) for bundle in bundles if kinds]
    drivers: list[Driver] = [
        AnchorDriver(
            f"{title}, {ANCHORS[name]}", engine, num=num, painted=name == "discs", pace=pace
        )
        for title, engine in zip(bundle_names(bundles), engines, strict=False)
        for name in kinds
    ]
    plain: dict[str, Driver] = {"mppi": MppiDriver(), "straight": StraightDriver()}
    if CFM_MPPI in names:
        who = f"anchorflow bench crowds --drivers {CFM_MPPI}"
        with needs_extra("crowds", who=who), needs_extra("train", who=who):
            from anchorflow_benchmarks.crowds.cfm_mppi import CfmMppiDriver
        plain[CFM_MPPI] = CfmMppiDriver()
    return drivers + [driver for name, driver in plain.items() if name in names]


def drawn_rooms(count: int, seeds: int) -> list[World]:
    """Return the runs in each of `count` rooms. Raises `SystemExit` without the simulator."""
    with needs_extra("crowds", who="anchorflow bench crowds --rooms"):
        from anchorflow_benchmarks.crowds.rooms import Room, draw_layout
    layouts = [draw_layout(index) for index in range(count)]
    numbered = enumerate(layout for layout in layouts for _ in range(seeds))
    return [Room(layout, seed=seed) for seed, layout in numbered]


def crowds(
    *,
    windows: Annotated[
        Path | None, typer.Option(help="Recorded people: a .npz file or a folder of them.")
    ] = None,
    limit: Annotated[
        int | None, typer.Option(min=1, help="Windows of a file, evenly spread.")
    ] = None,
    rooms: Annotated[
        int | None,
        typer.Option(min=0, help="Drawn rooms.", show_default="100 without --windows"),
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, help="Runs of each driver in a room.")] = SEEDS,
    drivers: Annotated[str, typer.Option(metavar="A,B")] = ",".join(DRIVERS),
    robot: Annotated[str, typer.Option(help=" or ".join(ROBOTS))] = ROBOTS[0],
    pace: Annotated[
        bool, typer.Option("--pace", help="Request the time that is left as horizon_s.")
    ] = False,
    bundle: options.Bundles = None,
    num: options.Num = 64,
    threads: options.Threads = None,
    out: options.Out = options.RESULTS,
) -> None:
    """Drive a robot among recorded people, and in rooms among people who react to it."""
    if robot not in ROBOTS:
        raise BenchmarkError(f"--robot: expected {' or '.join(ROBOTS)}, got {robot!r}")
    bundles = [open_bundle(folder) for folder in bundle or [options.STUDENT]]
    names = options.comma_separated(drivers)
    contenders = drivers_of(names, bundles, num=num, pace=pace, threads=threads)
    worlds: list[World] = []
    if windows is not None:
        worlds += read_recordings(windows, limit=limit)
    if count := (ROOMS if windows is None else 0) if rooms is None else rooms:
        worlds += drawn_rooms(count, seeds)
    trips: dict[str, dict[str, list[Trip]]] = {}
    with progress("driving", len(worlds) * len(contenders)) as advance:
        for world in worlds:
            for driver in contenders:
                trip = drive(world, driver, robot=robot)
                for title in {world.kind: None, world.name: None}:
                    trips.setdefault(title, {}).setdefault(driver.name, []).append(trip)
                advance(1)
    about = {
        "robot": f"{robot}, {V_MAX:g} m/s, {A_MAX:g} m/s^2, {1 / TICK_S:g} decisions a second",
        "anchors": f"{num} a request" + (", horizon_s the time that is left" if pace else ""),
    }
    tables = [
        ResultTable(title, [row_of(driver, driven) for driver, driven in rows.items()])
        for title, rows in trips.items()
    ]
    report("Crowds", about, tables, out)
