"""`anchorflow bench closed-loop`: does a robot drive better with anchors?"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.judged_bundles import open_bundle
from anchorflow_benchmarks.samplers import parse_sampler
from anchorflow_cli.bench_options import (
    RESULTS,
    BundleOption,
    NumOption,
    OutOption,
    SamplerOption,
    ThreadsOption,
    first_card,
    whole_numbers,
)
from anchorflow_cli.bench_output import progress, report
from anchorflow_cli.extras import needs_extra
from anchorflow_cli.options import StyleOption, file_option, style_text, url_option
from anchorflow_client.contract import ModelCard
from anchorflow_service.bundle import DEFAULT_BUNDLE

if TYPE_CHECKING:
    from anchorflow_benchmarks.closed_loop.contest import ContestConfig
    from anchorflow_benchmarks.closed_loop.world import World

DIGITS = 12  # of a SHA-256
WORLDS = "FILE|drawn:N:SEED|forests:N:SEED"


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
    num: NumOption = 64,
    sampler: SamplerOption = "midpoint:uniform2",
    bundle: BundleOption = DEFAULT_BUNDLE,
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
    robot: Annotated[str, typer.Option(help="unicycle or double-integrator.")] = "unicycle",
    limit_s: Annotated[float, typer.Option(min=0.1, help="Simulated time of a run.")] = 50.0,
    workers: Annotated[int, typer.Option(min=1, help="Processes, one run each at a time.")] = 1,
    threads: ThreadsOption = None,
    log: Annotated[
        Path | None, file_option("A file that takes down each run, to go on from.")
    ] = None,
    out: OutOption = RESULTS,
) -> None:
    """Drive a robot by MPPI alone, with lines, with routes and a finish, with served anchors."""
    with needs_extra("robot", who="anchorflow bench closed-loop"):
        from anchorflow_benchmarks.closed_loop.contest import (
            ContestConfig,
            contenders_of,
            run_contest,
        )
        from anchorflow_benchmarks.closed_loop.drive import DriveConfig
        from anchorflow_benchmarks.closed_loop.robots import ROBOTS
        from anchorflow_benchmarks.closed_loop.run_log import RunLog
        from anchorflow_benchmarks.closed_loop.scoring import contest_tables
        from anchorflow_benchmarks.closed_loop.world_sources import load_worlds
    if robot not in ROBOTS:
        raise BenchmarkError(f"--robot: expected {' or '.join(ROBOTS)}, got {robot!r}")
    opened = open_bundle(bundle)
    anchors = f"{num} a request, {sampler}"
    if url is not None:
        # Of a service that serves no model refusals would be timed as answers.
        anchors += f", of {_version(first_card(url))} at {url}"
    spec = parse_sampler(sampler, opened.card)
    contenders = contenders_of(whole_numbers(motions, "--motions"), anchors=num)
    config = ContestConfig(
        bundle=bundle,
        url=url,
        threads=threads,
        latency_ms=latency_ms,
        lost=lost,
        robot=robot,
        drive=DriveConfig(
            limit_s=limit_s,
            lidar_noise=noise,
            horizon_s=opened.card.cost_map.limits.horizon_s,
            options={
                "w_style": style,
                "num_samples": num,
                "sampler": {"method": spec.method, "schedule": list(spec.schedule)},
            },
        ),
    )
    found = load_worlds(worlds, limit=limit)
    about = _about(
        config,
        found,
        source=Path(worlds),
        seeds=seeds,
        anchors=anchors,
        bundle=_version(opened.card),
        style=style_text(style),
    )
    known = None if log is None else RunLog(log, about)
    with progress("driving", len(found) * seeds * len(contenders)) as advance:
        results = run_contest(
            contenders, found, config, seeds=seeds, workers=workers, progress=advance, log=known
        )
    tables = contest_tables(results, [contender.name for contender in contenders])
    report("Closed loop", about, tables, out)


def _about(
    config: ContestConfig,
    worlds: Sequence[World],
    *,
    source: Path,
    seeds: int,
    anchors: str,
    bundle: str,
    style: str,
) -> dict[str, str]:
    """What the tables tell of the contest: all that changes a run."""
    drive, latency_ms = config.drive, config.latency_ms
    narrowest = min(world.to_spare for world in worlds)
    file = f" ({_digest(source.read_bytes())})" if source.is_file() else ""
    threads = "" if config.threads is None else f", {config.threads} threads"
    return {
        "worlds": f"{source.name}{file}, {len(worlds)} driven, {seeds} runs each; at least "
        f"{narrowest:.2f} m to spare on the widest way",
        "robot": f"{config.robot}, {1 / drive.tick_s:g} commands a second, "
        f"lidar noise {drive.lidar_noise:g} m, {drive.limit_s:g} s a run at most",
        "bundle": bundle,
        "anchors": anchors,
        "style": style,
        "latency": f"as measured{threads}" if latency_ms is None else f"{latency_ms:g} ms",
        "answers lost": f"{100 * config.lost:g}%",
    }


def _version(card: ModelCard) -> str:
    return f"{card.name} {card.version} ({card.sha256[:DIGITS]})"


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:DIGITS]
