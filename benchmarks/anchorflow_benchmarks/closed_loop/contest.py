"""A contest: the same worlds and seeds for MPPI alone and with the anchors of others."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter, process_time

import torch

from anchorflow_benchmarks.closed_loop.anchor_sources import (
    LinesSource,
    LossySource,
    RoutesSource,
)
from anchorflow_benchmarks.closed_loop.drive import Drive, DriveConfig
from anchorflow_benchmarks.closed_loop.mppi import MppiConfig, MppiController
from anchorflow_benchmarks.closed_loop.robots import ROBOTS
from anchorflow_benchmarks.closed_loop.run_log import RunKey, RunLog
from anchorflow_benchmarks.closed_loop.scoring import Result
from anchorflow_benchmarks.closed_loop.simulated_time import LatencyExecutor, SimulatedTime
from anchorflow_benchmarks.closed_loop.world import World
from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_client.http import AnchorClient
from anchorflow_client.planner import AnchorSource, Planner
from anchorflow_service.bundle import Bundle, load_bundle
from anchorflow_service.engine import Engine
from anchorflow_service.local import LocalClient


@dataclass(frozen=True)
class Contender:
    """name: as the table calls it; anchors: None, "lines", "routes" or "served"

    samples: motions that MPPI may roll out a tick, anchors included
    """

    name: str
    anchors: str | None
    samples: int


def contenders_of(motions: Sequence[int], *, anchors: int) -> list[Contender]:
    """MPPI alone, with lines, with routes and a finish, with served anchors; by number of motions.

    Raises:
        BenchmarkError: the motions do not hold the anchors and one more.
    """
    if few := [count for count in motions if count < anchors + 2]:
        raise BenchmarkError(
            f"motions: expected at least {anchors + 2}, for {anchors} anchors a request, "
            f"got {few[0]}"
        )
    helped = {
        "": None,
        " + straight lines": "lines",
        " + routes and finish": "routes",
        " + served anchors": "served",
    }
    return [
        Contender(f"MPPI{by}, {count} motions", source, count)
        for count in motions
        for by, source in helped.items()
    ]


@dataclass(frozen=True)
class ContestConfig:
    """What all contenders share.

    bundle: of the served anchors, and of the finish of routes
    url: of a service that answers in place of the bundle
    threads: of a request to the bundle's engine
    latency_ms: of an answer in simulated time; None: as long as it took, see `run_contest`
    lost: share of the answers that never arrive
    """

    bundle: Path
    url: str | None = None
    threads: int | None = None
    latency_ms: float | None = None
    lost: float = 0.0
    robot: str = "unicycle"
    mppi: MppiConfig = field(default_factory=MppiConfig)
    drive: DriveConfig = field(default_factory=DriveConfig)


@dataclass(frozen=True)
class Heat:
    """One run to be made."""

    contender: Contender
    world: World
    seed: int

    @property
    def key(self) -> RunKey:
        """What tells it from the others of a contest."""
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
    """Every contender's run in every world, seed by seed; `progress` gets 1 a finished run.

    What `log` holds already is not driven again.

    Each worker is a process with a single thread for torch. An engine's answer takes the time that
    this process keeps cores busy with it, so that a machine that others share makes no robot slow;
    a service's takes what the wall clock says.

    Raises:
        BundleError: the bundle cannot be opened.
        BrokenProcessPool: a worker was killed.
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
    with ProcessPoolExecutor(
        workers, mp_context=get_context("spawn"), initializer=torch.set_num_threads, initargs=(1,)
    ) as pool:
        driven = pool.map(partial(run_heat, config=config), to_drive)
        for heat, result in zip(to_drive, driven, strict=True):
            known[heat.key] = result
            if log is not None:
                log.add(result)
            progress(1)
    return [known[heat.key] for heat in heats]


def run_heat(heat: Heat, config: ContestConfig) -> Result:
    """One run, on this process's threads."""
    clock, contender = SimulatedTime(), heat.contender
    robot = ROBOTS[config.robot]()
    mppi = replace(config.mppi, samples=contender.samples)
    controller = MppiController(robot, mppi, tick_s=config.drive.tick_s)
    fixed_s = None if config.latency_ms is None else 1e-3 * config.latency_ms
    stopwatch = process_time if config.url is None else perf_counter
    executor = LatencyExecutor(clock, stopwatch=stopwatch, fixed_s=fixed_s)
    with _source(contender, config) as source:
        planner = None
        if source is not None:
            source = LossySource(source, share=config.lost, seed=heat.seed)
            asking = config.drive.asking(mppi.cost.margin)
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
    return Result(contender.name, world.name, heat.seed, world.path_length, run, latencies)


@contextmanager
def _source(contender: Contender, config: ContestConfig) -> Iterator[AnchorSource | None]:
    if contender.anchors is None:
        yield None
    elif contender.anchors == "lines":
        yield LinesSource(config.drive.horizon_s)
    elif contender.anchors == "routes":
        yield RoutesSource.of(_bundle(config.bundle))
    elif config.url is None:
        yield LocalClient(_engine(config.bundle, config.threads))
    else:
        with AnchorClient(
            config.url, timeout_s=1e-3 * config.drive.asking(0.0).max_age_ms
        ) as client:
            yield client


@lru_cache(maxsize=1)
def _engine(bundle: Path, threads: int | None) -> Engine:
    """A worker opens its bundle once."""
    return Engine(_bundle(bundle), threads=threads)


@lru_cache(maxsize=1)
def _bundle(folder: Path) -> Bundle:
    return load_bundle(folder)
