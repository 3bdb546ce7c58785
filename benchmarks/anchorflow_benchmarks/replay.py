"""Recorded drives as tables: what the node would have planned at every tick, by bundle.

Run by `anchorflow bench replay`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from anchorflow_benchmarks import BenchmarkError, options
from anchorflow_benchmarks.report import ResultTable, Row, progress, report
from anchorflow_cli.replay import read_parameters
from anchorflow_ros.driver import Decision, Driver
from anchorflow_ros.frames import poses_of
from anchorflow_ros.parameters import IN_PROCESS, Settings
from anchorflow_ros.replay import AtOnce, decisions
from anchorflow_ros.services import client_of

AHEAD_S = 1.0
"""After the start of the later of two plans, when their best anchors are compared."""
ELSEWHERE = 0.3  # m apart, from which the robot was sent another way


@dataclass(frozen=True, eq=False)
class _Best:
    """The best anchor of a plan: poses [T, 3] from `starts_at` s on, every `step_s`."""

    poses: NDArray[np.floating]
    starts_at: float
    step_s: float

    def place(self, time: float) -> NDArray[np.floating]:
        """Return x and y [2] m at a time in s; the last place after the end."""
        at = self.starts_at + self.step_s * np.arange(len(self.poses))
        return np.array([np.interp(time, at, self.poses[:, axis]) for axis in (0, 1)])


def figures(decided: Iterable[Decision]) -> Row:
    """Return the figures of a drive.

    ticks: with a goal; braked: share of them; plans: answers
    safe: share of the plans with a safe anchor; anchors safe: mean share of a plan's anchors
    shift m, elsewhere: how far the best anchors of one plan and the next are apart AHEAD_S after
        the later one's start, the median, and the share that is ELSEWHERE
    p50 ms, p95 ms: of a plan
    """
    ticks = braked = 0
    shown, bests, safe, times = None, [], [], []
    for decision in decided:
        ticks += not decision.idle
        braked += decision.braking and not decision.idle
        plan = decision.plan
        if plan is None or plan.batch is None or plan.request_id == shown:
            continue
        shown, batch = plan.request_id, plan.batch
        safe.append(float(np.mean(batch.safe)) if batch.safe is not None else np.nan)
        times.append(batch.timing_ms.get("total", np.nan))
        if plan.best is not None:
            step_s = float(np.broadcast_to(batch.dt, len(batch.trajectories))[plan.best])
            bests.append(_Best(poses_of(batch, plan.best), decision.starts_at, step_s))
    if not safe:
        raise BenchmarkError("expected a bag with a goal, in which something is planned, got none")
    moments = [(one, later, later.starts_at + AHEAD_S) for one, later in pairwise(bests)]
    shifts = [float(np.linalg.norm(a.place(t) - b.place(t))) for a, b, t in moments] or [0.0]
    return {
        "ticks": ticks,
        "braked": braked / max(ticks, 1),
        "plans": len(safe),
        "safe": float(np.mean(np.array(safe) > 0.0)),
        "anchors safe": float(np.mean(safe)),
        "shift m": float(np.median(shifts)),
        "elsewhere": float(np.mean(np.array(shifts) > ELSEWHERE)),
        "p50 ms": float(np.percentile(times, 50)),
        "p95 ms": float(np.percentile(times, 95)),
    }


def replay(
    bags: Annotated[list[Path], typer.Argument(help="rosbag2 folders or .mcap files.")],
    *,
    bundles: options.Bundles = None,
    params: Annotated[
        Path | None, typer.Option(help="Parameter file of the node, for topics, robot and map.")
    ] = None,
    out: options.Out = options.RESULTS,
) -> None:
    """Plan at every tick of recorded drives with each bundle: safe shares, commitment, times."""
    asked = {} if params is None else read_parameters(params)
    rows: dict[Path, list[Row]] = {bag: [] for bag in bags}
    chosen = bundles or [options.DEFAULT_BUNDLE, options.STUDENT]
    with progress("replaying", len(chosen) * len(bags)) as advance:
        for bundle in chosen:
            settings = Settings.of(asked | {"service": IN_PROCESS, "service.bundle": str(bundle)})
            with client_of(settings) as client:
                for bag in bags:
                    driver = Driver(settings, client, executor=AtOnce())
                    found = figures(decision for _, decision in decisions(bag, driver))
                    rows[bag].append({"bundle": bundle.name, **found})
                    driver.close()
                    advance(1)
    tables = [ResultTable(bag.name, rows[bag]) for bag in bags]
    report("Replay", {"bags": ", ".join(bag.name for bag in bags)}, tables, out)
