"""A contest on the same worlds and seeds: MPPI alone, and with the anchors of several sources.

Run by `anchorflow bench closed-loop`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter, process_time
from typing import Annotated

import torch
import typer

from anchorflow_benchmarks import BenchmarkError, options
from anchorflow_benchmarks.closed_loop.anchor_sources import (
    LinesSource,
    LossySource,
    RoutesSource,
)
from anchorflow_benchmarks.closed_loop.controllers import AnchorController, Controller
from anchorflow_benchmarks.closed_loop.drive import Drive, DriveConfig
from anchorflow_benchmarks.closed_loop.mppi import MppiConfig, MppiController
from anchorflow_benchmarks.closed_loop.results import Result, RunKey, RunLog, contest_tables
from anchorflow_benchmarks.closed_loop.robots import ROBOTS
from anchorflow_benchmarks.closed_loop.simulated_time import LatencyExecutor, SimulatedTime
from anchorflow_benchmarks.closed_loop.worlds import World, load_worlds
from anchorflow_benchmarks.planners import open_bundle, parse_sampler
from anchorflow_benchmarks.report import progress, report
from anchorflow_benchmarks.turns import p50
from anchorflow_cli.options import StyleOption, file_option, style_text, url_option
from anchorflow_client.contract import ModelCard
from anchorflow_client.http import AnchorClient
from anchorflow_client.planner import AnchorSource, Planner
from anchorflow_control import MppiConfig as ControlConfig
from anchorflow_service.bundle import DEFAULT_BUNDLE, Bundle, load_bundle
from anchorflow_service.engine import Engine
from anchorflow_service.local import LocalClient

WORLDS = "FILE|drawn:N:SEED|narrow:N:SEED|forests:N:SEED"
HASH_DIGITS = 12
SOURCES = {
    "": None,
    " + straight lines": "lines",
    " + routes and finish": "routes",
    " + served anchors": "served",
}


CONTROLLERS = {"anchorflow": "AnchorFlow's MPPI", "pytorch_mppi": "pytorch_mppi"}
"""The controllers that drive, and their names in the table."""


@dataclass(frozen=True)
class Contender:
    """name: in the table; anchors: None, "lines", "routes" or "served"

    samples: motions that MPPI rolls out per tick, anchors included; controller: of CONTROLLERS
    """

    name: str
    anchors: str | None
    samples: int
    controller: str = "pytorch_mppi"


def contenders_of(
    motions: Sequence[int],
    *,
    anchors: int,
    controllers: Sequence[str] = tuple(CONTROLLERS),
    sources: Sequence[str | None] = tuple(SOURCES.values()),
) -> list[Contender]:
    """Return each controller alone and with each source of anchors, for each number of motions.

    Raises `BenchmarkError` if there are fewer motions than anchors and two more.
    """
    if few := [count for count in motions if count < anchors + 2]:
        raise BenchmarkError(
            f"motions: expected at least {anchors + 2}, for {anchors} anchors a request, "
            f"got {few[0]}"
        )
    return [
        Contender(f"{CONTROLLERS[controller]}{by}, {count} motions", source, count, controller)
        for count in motions
        for controller in controllers
        for by, source in SOURCES.items()
        if source in sources
    ]


@dataclass(frozen=True)
class ContestConfig:
    """Settings that all contenders share.

    bundle: serves the anchors, and finishes routes
    url: of a service that replaces the bundle
    threads: per request to the bundle's engine
    latency_ms: of an answer in simulated time; None for the measured time, see `run_contest`
    lost: share of the answers that never arrive
    """

    bundle: Path
    url: str | None = None
    threads: int | None = None
    latency_ms: float | None = None
    lost: float = 0.0
    robot: str = "unicycle"
    mppi: MppiConfig = field(default_factory=MppiConfig)
    control: ControlConfig = field(default_factory=ControlConfig)
    drive: DriveConfig = field(default_factory=DriveConfig)


@dataclass(frozen=True)
class Heat:
    """One run of a contender in a world."""

    contender: Contender
    world: World
    seed: int

    @property
    def key(self) -> RunKey:
        return self.contender.name, self.world.name, self.seed


def run_contest(
    contenders: Sequence[Contender],
    worlds: Sequence[World],
    config: ContestConfig,
    *,
    seeds: int = 1,
    workers: int = 1,
    progress: Callable[[int], None] = lambda _: None,
    log: RunLog | None = None,
) -> list[Result]:
    """Run every contender in every world with every seed; `progress` gets 1 per finished run.

    Runs in `log` are not repeated. Several workers are processes, a single one is this process;
    each has one thread for torch. The latency of an engine is its processor time, so that other
    load on the machine does not slow the robot; that of a service is wall time.

    Raises `BundleError` if the bundle cannot be opened; `BrokenProcessPool` if a worker was killed.
    """
    heats = [
        Heat(contender, world, seed)
        for world in worlds
        for seed in range(seeds)
        for contender in contenders
    ]
    known = {} if log is None else log.known()
    to_drive = [heat for heat in heats if heat.key not in known]
    if to_drive != heats:
        progress(len(heats) - len(to_drive))
    with _mapper(workers) as mapped:
        driven = mapped(partial(run_heat, config=config), to_drive)
        for heat, result in zip(to_drive, driven, strict=True):
            known[heat.key] = result
            if log is not None:
                log.add(result)
            progress(1)
    return [known[heat.key] for heat in heats]


@contextmanager
def _mapper(workers: int) -> Iterator[Callable[..., Iterator[Result]]]:
    """Yield `map` over that many processes, of one thread for torch each; of one, `map` itself."""
    if workers > 1:
        with ProcessPoolExecutor(
            workers, get_context("spawn"), initializer=torch.set_num_threads, initargs=(1,)
        ) as pool:
            yield pool.map
        return
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield map
    finally:
        torch.set_num_threads(threads)


def run_heat(heat: Heat, config: ContestConfig) -> Result:
    """Make one run in this process."""
    clock, contender = SimulatedTime(), heat.contender
    controller, margin = _controller(heat, config)
    fixed_s = None if config.latency_ms is None else 1e-3 * config.latency_ms
    stopwatch = process_time if config.url is None else perf_counter
    executor = LatencyExecutor(clock, stopwatch=stopwatch, fixed_s=fixed_s)
    with _source(contender, config) as source:
        planner = None
        if source is not None:
            source = LossySource(source, share=config.lost, seed=heat.seed)
            asking = config.drive.asking(margin)
            planner = Planner(source, asking, clock=clock, executor=executor)
        drive = Drive(
            heat.world,
            controller,
            planner=planner,
            clock=clock,
            config=config.drive,
            seed=heat.seed,
        )
        run = drive.run()
    latencies = tuple(1e3 * seconds for seconds in executor.latencies_s)
    world = heat.world
    command_ms = p50([1e3 * seconds for seconds in drive.commands_s]) if drive.commands_s else None
    return Result(
        contender.name, world.name, heat.seed, world.path_length, run, latencies, command_ms
    )


def _controller(heat: Heat, config: ContestConfig) -> tuple[Controller, float]:
    """Return the controller of a run, and the margin in m that it keeps."""
    robot, tick_s, samples = ROBOTS[config.robot](), config.drive.tick_s, heat.contender.samples
    if heat.contender.controller == "pytorch_mppi":
        rival = replace(config.mppi, samples=samples)
        return MppiController(robot, rival, tick_s=tick_s), rival.cost.margin
    own = replace(config.control, motions=samples)
    return AnchorController(robot, own, tick_s=tick_s, seed=heat.seed), own.margin


@contextmanager
def _source(contender: Contender, config: ContestConfig) -> Iterator[AnchorSource | None]:
    if contender.anchors is None:
        yield None
    elif contender.anchors == "lines":
        yield LinesSource(config.drive.horizon_s)
    elif contender.anchors == "routes":
        yield RoutesSource(_bundle(config.bundle))
    elif config.url is None:
        yield LocalClient(_engine(config.bundle, config.threads))
    else:
        with AnchorClient(
            config.url, timeout_s=1e-3 * config.drive.asking(0.0).max_age_ms
        ) as client:
            yield client


@lru_cache(maxsize=1)
def _engine(bundle: Path, threads: int | None) -> Engine:
    return Engine(_bundle(bundle), threads=threads)


@lru_cache(maxsize=1)
def _bundle(folder: Path) -> Bundle:
    return load_bundle(folder)


def closed_loop(
    worlds: Annotated[
        str, typer.Argument(metavar=WORLDS, help="Worlds: a .npz file (scenes too), or drawn ones.")
    ],
    *,
    limit: Annotated[int, typer.Option(min=1, help="Worlds at most, evenly spread.")] = 50,
    seeds: Annotated[int, typer.Option(min=1, help="Runs of each contender in a world.")] = 1,
    motions: Annotated[
        str, typer.Option(metavar="K,K", help="That MPPI rolls out a tick, anchors included.")
    ] = "512",
    num: options.Num = 64,
    sampler: options.Sampler = "midpoint:uniform2",
    bundle: options.Bundle = DEFAULT_BUNDLE,
    url: Annotated[
        str | None, url_option("A service that answers in place of the bundle's engine.")
    ] = None,
    style: StyleOption = None,
    latency_ms: Annotated[
        float | None,
        typer.Option(min=0, help="Of an answer in simulated time.", show_default="as it took"),
    ] = None,
    lost: Annotated[float, typer.Option(min=0, max=1, help="Share of the answers.")] = 0.0,
    noise: Annotated[float, typer.Option(min=0, help="Of the lidar's ranges, m.")] = 0.01,
    robot: Annotated[str, typer.Option(help=f"{', '.join(ROBOTS)}.")] = "unicycle",
    limit_s: Annotated[float, typer.Option(min=0.1, help="Simulated time of a run.")] = 50.0,
    workers: Annotated[int, typer.Option(min=1, help="Processes, one run each at a time.")] = 1,
    threads: options.Threads = None,
    log: Annotated[
        Path | None, file_option("A file that takes down each run, to go on from.")
    ] = None,
    out: options.Out = options.RESULTS,
) -> None:
    """Drive a robot by MPPI alone, with lines, with routes and a finish, with served anchors."""
    if robot not in ROBOTS:
        raise BenchmarkError(f"--robot: expected {' or '.join(ROBOTS)}, got {robot!r}")
    opened = open_bundle(bundle)
    anchors = f"{num} a request, {sampler}"
    if url is not None:
        # Checked now: refusals of a service without a model would be timed as answers.
        anchors += f", of {_version(options.first_card(url))} at {url}"
    spec = parse_sampler(sampler, opened.card)
    counts = options.whole_numbers(motions, "--motions")
    contenders = contenders_of(counts, anchors=num)
    if is_rectangle := ROBOTS[robot]().half is not None:  # the others know discs
        contenders = contenders_of(
            counts, anchors=num, controllers=("anchorflow",), sources=(None, "served")
        )
    asked = {"method": spec.method, "schedule": list(spec.schedule)}
    drive = DriveConfig(
        limit_s=limit_s,
        lidar_noise=noise,
        horizon_s=opened.card.cost_map.limits.horizon_s,
        options={
            "w_style": style,
            "num_samples": num,
            **({} if is_rectangle else {"sampler": asked}),
        },
    )
    config = ContestConfig(bundle, url, threads, latency_ms, lost, robot, drive=drive)
    found = load_worlds(worlds, limit=limit)
    source, narrowest = Path(worlds), min(world.to_spare for world in found)
    file = f" ({_digest(source.read_bytes())})" if source.is_file() else ""
    measured = "as measured" + ("" if threads is None else f", {threads} threads")
    about = {  # everything that changes a run
        "worlds": f"{source.name}{file}, {len(found)} driven, {seeds} runs each; at least "
        f"{narrowest:.2f} m to spare on the widest way",
        "robot": f"{robot}, {1 / drive.tick_s:g} commands a second, "
        f"lidar noise {noise:g} m, {limit_s:g} s a run at most",
        "bundle": _version(opened.card),
        "anchors": anchors,
        "style": style_text(style),
        "latency": measured if latency_ms is None else f"{latency_ms:g} ms",
        "answers lost": f"{100 * lost:g}%",
    }
    known = None if log is None else RunLog(log, about)
    with progress("driving", len(found) * seeds * len(contenders)) as advance:
        results = run_contest(
            contenders, found, config, seeds=seeds, workers=workers, progress=advance, log=known
        )
    tables = contest_tables(results, [contender.name for contender in contenders])
    report("Closed loop", about, tables, out)


def _version(card: ModelCard) -> str:
    return f"{card.name} {card.version} ({card.sha256[:HASH_DIGITS]})"


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:HASH_DIGITS]
