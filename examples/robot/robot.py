"""A robot that requests anchors while it drives through a world that it sees only by lidar.

    anchorflow serve                                      # in another terminal
    python examples/robot/robot.py --record robot.gif      # or --view, or neither

Everything about the robot, its lidar, its map and MPPI is `anchorflow_benchmarks.closed_loop`;
this program connects it to a client in real time.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path

from robot_view import LiveView, Recorder

from anchorflow_benchmarks.closed_loop.drive import Drive, DriveConfig, Run, Tick
from anchorflow_benchmarks.closed_loop.mppi import MppiConfig, MppiController
from anchorflow_benchmarks.closed_loop.robots import ROBOTS
from anchorflow_benchmarks.closed_loop.simulated_time import SimulatedTime
from anchorflow_benchmarks.closed_loop.worlds import load_worlds
from anchorflow_client import AnchorClient, AnchorFlowError, Planner
from anchorflow_client.base_client import BaseClient
from anchorflow_client.contract.fields import STYLES


class PacedTime(SimulatedTime):
    """Simulated time that never runs ahead of the wall clock."""

    def __init__(self) -> None:
        super().__init__()
        self._began = time.monotonic()

    def advance(self, seconds: float) -> None:
        super().advance(seconds)
        time.sleep(max(0.0, self._began + self.now - time.monotonic()))


class ErrorLog:
    """Prints why requests fail or return nothing safe, without repeating a reason."""

    def __init__(self) -> None:
        self._printed = ""

    def __call__(self, tick: Tick) -> None:
        plan = tick.plan
        if plan is None:
            return
        if plan.stuck:
            print(f"{tick.time_s:5.1f} s  stuck: another route, or another seed")
        error = plan.last_error
        reason = f"{type(error).__name__}: {error}" if error else plan.reason or ""
        if reason not in ("", self._printed):
            print(f"{tick.time_s:5.1f} s  {reason}")
        self._printed = reason or self._printed


def main(arguments: Sequence[str] | None = None) -> None:
    options = parse(arguments)
    with ExitStack() as stack:
        try:
            run = drive(options, stack)
        except AnchorFlowError as error:
            raise SystemExit(str(error)) from error
    print(
        f"{run.end.value} after {run.time_s:.1f} s and {run.length:.1f} m, "
        f"at least {run.clearance:.2f} m from every post; "
        f"{run.ticks_braked} ticks braked for want of a plan"
    )


def drive(options: argparse.Namespace, stack: ExitStack) -> Run:
    """Drive once, with the command's options."""
    worlds = load_worlds(options.worlds)
    world = worlds[options.world % len(worlds)]
    client = None if options.alone else stack.enter_context(connect(options))
    config = DriveConfig(
        limit_s=options.limit_s,
        horizon_s=None if client is None else horizon_of(client),
        options={
            "num_samples": options.num,
            "w_style": options.style,
            "sampler": {"method": options.method, "schedule": {"uniform": options.steps}},
        },
    )
    clock, robot = PacedTime(), ROBOTS[options.robot]()
    controller = MppiController(robot, MppiConfig(), tick_s=config.tick_s)
    planner = None
    if client is not None:
        # The world and the age of a plan pause while this program is late.
        asking = replace(config.asking(controller.config.cost.margin), max_age_ms=options.max_age)
        planner = stack.enter_context(Planner(client, asking, clock=clock))
    watchers: list[Callable[[Tick], None]] = [ErrorLog()]
    if options.view:
        watchers.append(LiveView(world, robot.radius))
    if options.record is not None:
        watchers.append(stack.enter_context(Recorder(world, robot.radius, options.record)))

    def on_tick(tick: Tick) -> None:
        for watch in watchers:
            watch(tick)

    run = Drive(world, controller, planner=planner, clock=clock, config=config, seed=options.seed)
    return run.run(on_tick)


def horizon_of(client: BaseClient) -> float | None:
    """Return the duration of all anchors; None if each has its own, or the card is unknown."""
    try:
        return client.models()[0].cost_map.limits.horizon_s
    except AnchorFlowError:
        return None


def connect(options: argparse.Namespace) -> BaseClient:
    """Return a client over zenoh if the option is given, else over HTTP."""
    timeout_s = 1e-3 * options.max_age
    if options.zenoh is None:
        try:
            return AnchorClient(options.url, timeout_s=timeout_s)
        except ValueError as error:
            raise SystemExit(f"--url: {error}") from error
    from anchorflow_client.zenoh_client import ZenohAnchorClient  # an extra: anchorflow[zenoh]

    return ZenohAnchorClient(options.zenoh, timeout_s=timeout_s)


def positive(text: str) -> float:
    with suppress(ValueError):
        if 0.0 < (value := float(text)) < math.inf:
            return value
    raise argparse.ArgumentTypeError(f"expected a finite number above 0, got {text!r}")


def whole(least: int) -> Callable[[str], int]:
    """Return a parser of whole numbers from `least`."""

    def read(text: str) -> int:
        if text.isdecimal() and (value := int(text)) >= least:
            return value
        raise argparse.ArgumentTypeError(
            f"expected a whole number of at least {least}, got {text!r}"
        )

    return read


def gif_path(text: str) -> Path:
    path = Path(text)
    if path.suffix.lower() != ".gif" or not path.parent.is_dir() or path.is_dir():
        raise argparse.ArgumentTypeError(
            f"expected a file .gif in a folder that is there, got {text!r}"
        )
    return path


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--url", default="http://127.0.0.1:8000", help="of the service")
    parser.add_argument("--zenoh", metavar="ENDPOINT", help="ask over zenoh, tcp/127.0.0.1:7447")
    parser.add_argument("--alone", action="store_true", help="MPPI without anchors")
    parser.add_argument("--robot", choices=sorted(ROBOTS), default="unicycle")
    parser.add_argument(
        "--worlds", metavar="FILE|drawn:N:SEED|forests:N:SEED", default="drawn:10:0"
    )
    parser.add_argument("--world", type=whole(0), default=0, help="which of them")
    parser.add_argument(
        "--seed", type=whole(0), default=0, help="of lidar noise and MPPI's samples"
    )
    parser.add_argument("--num", type=whole(1), default=64, help="anchors a request")
    parser.add_argument("--style", choices=sorted(STYLES), default="balanced")
    parser.add_argument("--method", default="midpoint", help="of the sampler")
    parser.add_argument("--steps", type=whole(1), default=2, help="of the sampler")
    parser.add_argument("--max-age", type=positive, default=1000.0, help="ms, of a plan")
    parser.add_argument("--limit-s", type=positive, default=50.0, help="time of the run")
    parser.add_argument("--view", action="store_true", help="a live picture")
    parser.add_argument(
        "--record", type=gif_path, metavar="FILE.gif", help="an animation of the run"
    )
    return parser.parse_args(arguments)


if __name__ == "__main__":
    main()
