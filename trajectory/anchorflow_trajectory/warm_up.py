"""Run everything that is compiled once, so that a process that serves keeps nobody waiting for it.

    python -m anchorflow_trajectory.warm_up [--niced] [STAGE ...]

compiles what a later process then finds on disk, in two processes at a time where there are two
cores: all of it, or the stages that are named. `still` is what a scene needs in which nothing
moves, `moving` what it needs besides, `poses` what bodies on wheels need, `guard` what judges plans
of cars, `foresight` what scores them among others who are foreseen. The loops of a stage are
compiled for types of their own, so that a service may answer after the first.
"""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.core.registry import cpu_target

from anchorflow_trajectory.bodies.outline import Outline
from anchorflow_trajectory.bodies.planner import BodyPlanner
from anchorflow_trajectory.bodies.scene import Body, BodyScene
from anchorflow_trajectory.bodies.wheels import Wheels
from anchorflow_trajectory.car.foresight import Driven, Foreseen, foreseen_poses
from anchorflow_trajectory.car.tracking import PLAN_TIMES, EgoState
from anchorflow_trajectory.compiled import code_folder
from anchorflow_trajectory.cost.clearance import GridField
from anchorflow_trajectory.cost.fields import CostFields
from anchorflow_trajectory.cost.trajectory_cost import TrajectoryCost
from anchorflow_trajectory.ending import among_movers, in_time
from anchorflow_trajectory.finish.bisection import bisect_to_safe
from anchorflow_trajectory.finish.certificate import are_safe
from anchorflow_trajectory.finish.optimisation_pass import OptimisationPass
from anchorflow_trajectory.finish.refiner import Refiner
from anchorflow_trajectory.guard.faults import Perceived, Raster
from anchorflow_trajectory.guard.guard import Guard
from anchorflow_trajectory.guard.motion import Car
from anchorflow_trajectory.guard.raster_boxes import boxes_in
from anchorflow_trajectory.guard.speeds import boxes_of
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.movers import MovingDiscs
from anchorflow_trajectory.ode.integrate import drawn
from anchorflow_trajectory.routes.reachable import connected
from anchorflow_trajectory.scene import Scene
from anchorflow_trajectory.threads import usable_cores

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

logger = logging.getLogger(__name__)

CAN_MASK = hasattr(signal, "pthread_sigmask")  # not on Windows
# Ctrl-C ends it without a traceback: it starts with SIGINT blocked, see `_started`.
PROGRAM = (
    "import signal, sys; signal.signal(signal.SIGINT, signal.SIG_DFL);"
    + CAN_MASK * "signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT]);"
    + "from anchorflow_trajectory.warm_up import main; main(sys.argv[1:])"
)
STILL, MOVING, POSES, GUARD, FORESIGHT = STAGES = ("still", "moving", "poses", "guard", "foresight")
USUAL_S = {STILL: 40, MOVING: 40, POSES: 30, GUARD: 10, FORESIGHT: 5}  # on two cores
SUBJECTS = {
    STILL: "routes and finish",
    MOVING: "moving obstacles",
    POSES: "footprints and wheels",
    GUARD: "the guard of cars",
    FORESIGHT: "cars among others who are foreseen",
}
DESCENT, NICED = "--descent", "--niced"
NICENESS = 10
CELLS, RESOLUTION = 32, 0.2  # of a map of 6.4 m
POST = slice(14, 18)


@dataclass(frozen=True)
class _Everything:
    """All that can be asked of a finish."""

    smooth: bool = True
    project: bool = True
    safety_margin: float = 0.1
    barrier: bool = True
    certified_margin: float = 0.0


def compile_loops(*stages: str) -> None:
    """Run the loops of these stages, of all by default, on a small scene.

    A second or less where they are found on disk, else up to a minute and a half.
    """
    for stage in stages or STAGES:
        _compile(stage)


def compiler(stage: str) -> subprocess.Popen[bytes]:
    """Start a niced process that compiles a stage and what it needs."""
    return _started(NICED, stage)


def is_kept(stage: str) -> bool:
    """Return whether the machine code of a stage is on disk, for this processor."""
    folder = code_folder()
    return folder is not None and _mark(folder, stage).exists()


@cache
def _compile(stage: str) -> None:
    with _alone():
        begin, before = time.monotonic(), is_kept(stage)
        if not before:
            logger.warning(
                "compiling loops for this processor, once (%s): about %d s on two cores",
                SUBJECTS[stage],
                USUAL_S[stage],
            )
        if stage == GUARD:
            _run_guard()
        elif stage == FORESIGHT:
            _run_foresight()
        elif stage == POSES:
            _run_poses()
        else:
            _run_splines(stage, beside=not before)
        if not before:
            logger.warning("compiled in %.0f s", time.monotonic() - begin)
            if (folder := code_folder()) is not None:
                with suppress(OSError):
                    _mark(folder, stage).touch()


def _run_splines(stage: str, *, beside: bool) -> None:
    """Run what anchors on a plane need; beside: the descent in a process of its own first."""
    scene = _scene(stage)
    if beside:
        process = _descent_beside(stage)
        _run_routes(scene)
        if process is not None:
            process.wait()
    _run_descent(scene)
    _run_finish(scene)


def _run_poses() -> None:
    """Plan for a body that parks, among what moves."""
    scene = _scene(MOVING)
    state = np.array([0.8, 3.2, 0.3, 0.1, *[0.0] * 5])
    scene = replace(scene, x_curr=state, x_goal=np.array([5.6, 3.2, 0.3, *[0.0] * 3]))
    body = Body(Outline.disc(0.25), Wheels(2.0, min_radius=0.5, reverse=True))

    def run(work: Sequence[Callable[[], object]]) -> None:
        for each in work:
            each()

    BodyPlanner(BodyScene(scene, body, (0.1, 0.1)), steps=8, run=run).plan(2, 0)


def _run_guard() -> None:
    """Judge a plan among a box of a raster and one without a velocity."""
    cells = Raster(np.zeros((2, 8, 8), np.float32), (-4.0, 4.0, -4.0, 4.0), step_s=0.5)
    cells.values[:, 1:3, 1:3] = 1.0
    boxes, rest = boxes_in(cells)
    boxes = np.concatenate([boxes, boxes_of(np.array([[3.0, 3.0, 0.0, 2.0, 1.0]]), cells)])
    times = np.array([1.0, 2.0])
    guard = Guard(times, Car(2.0, 1.0, 0.5), 0.1, Perceived(cells, boxes, rest), 1.0)
    guard.with_stop(np.array([[[0.1, 0.0, 0.0], [0.2, 0.0, 0.0]]]))


def _run_foresight() -> None:
    """Score a plan beside a box that may go one way."""
    road = Raster(np.ones((1, 8, 8), np.float32), (-4.0, 4.0, -4.0, 4.0))
    now, half = np.array([[3.0, 3.0, 0.0]]), np.array([[1.0, 0.5]])
    ways = foreseen_poses(now, np.repeat(now[:, None, None], len(PLAN_TIMES), 2))
    foreseen = Foreseen(ways, np.ones((1, 1)), half, np.array([[3.0, -3.0]]))
    start, plans = EgoState(np.zeros(3), 0.1, 0.0, 0.0), np.zeros((1, len(PLAN_TIMES), 3))
    Driven.of(plans, start, Car(2.0, 1.0, 0.5), road, wheelbase=2.0).among(foreseen)


@contextmanager
def _alone() -> Iterator[None]:
    """Let one process compile at a time: numba's files are not made for two."""
    folder = code_folder()
    with ExitStack() as stack:
        if folder is not None and fcntl is not None:
            with suppress(OSError):  # of a folder that may only be read
                lock = stack.enter_context((folder / "lock").open("w"))
                fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _mark(folder: Path, stage: str) -> Path:
    """Return the file that says that a stage was compiled for this processor by this numba."""
    context: Any = cpu_target.target_context
    machine = numba.__version__, context.codegen().magic_tuple()
    return folder / f"{stage}-{sha256(repr(machine).encode()).hexdigest()[:12]}"


def _descent_beside(stage: str) -> subprocess.Popen[bytes] | None:
    """Start a process that compiles the descent; None if there is no use in it."""
    if code_folder() is None or usable_cores() < 2:
        return None
    try:
        return _started(DESCENT, stage)
    except OSError:  # the descent is compiled here then
        return None


def _started(*arguments: str) -> subprocess.Popen[bytes]:
    """Start the program; a Ctrl-C while Python starts waits until it can end without a word."""
    if not CAN_MASK:
        return subprocess.Popen([sys.executable, "-c", PROGRAM, *arguments])
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        return subprocess.Popen([sys.executable, "-c", PROGRAM, *arguments])
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _scene(stage: str) -> Scene:
    cost_map = np.zeros((3, CELLS, CELLS), np.float32)
    cost_map[0, POST, POST], cost_map[1], cost_map[2, :4] = 1.0, 1.0, 0.5
    crossing = MovingDiscs.of(np.array([[3.0, 5.0]]), np.array([[0.0, -1.0]]), np.array([0.3]))
    return Scene(
        cost_map=cost_map,
        resolution=RESOLUTION,
        origin=np.zeros(2),
        robot_radius=0.25,
        x_curr=np.array([0.8, 3.2, 0.3, 0.0, 0.0, 0.0]),
        x_goal=np.array([5.6, 3.2, 0.0, 0.0]),
        w_style=np.array([0.4, 0.3, 0.3]),
        motion=MotionLimits(v_max=2.0, a_max=3.0),
        movers=crossing if stage == MOVING else None,
    )


def _run_routes(scene: Scene) -> None:
    drawn(np.zeros((1, 1), np.float32), np.zeros((1, 1), np.float32))
    connected(scene.occupied, 0)
    _ = scene.route_splines


def _run_descent(scene: Scene) -> None:
    """Run the descent and the verdict, along straight lines over even ground."""
    field = GridField(np.ones((CELLS, CELLS), np.float32), scene.resolution, scene.origin)
    fields, basis, ends = CostFields(field, None, scene.movers), scene.basis, scene.ends
    cost = TrajectoryCost(basis, fields, scene.motion, scene.effective_style, 1.0, 0.05)
    splines = basis.rest_curves(ends, np.ones(2))
    optimised, _ = OptimisationPass(1, 0.1, shares=(1.0,)).run(cost, splines, ends)
    safe, route = np.array([True, False]), np.zeros(2, np.intp)
    among: dict[str, Any] = {"movers": scene.movers}
    bisect_to_safe(optimised, safe, ends, basis, field, scene.motion, route=route, **among)
    are_safe(optimised, basis, field, scene.motion, **among)
    cost.value(optimised)


def _run_finish(scene: Scene) -> None:
    """Run everything else, and all of it together."""
    if scene.movers is not None:
        scene = among_movers(scene)
        in_time(scene, 1.0, 0.0)
    states = scene.route_states
    Refiner(scene, steps=1).refine(states, np.arange(len(states)), _Everything())


def main(arguments: Sequence[str]) -> None:
    """Run the program."""
    logging.basicConfig(format="%(message)s")
    if NICED in arguments and hasattr(os, "nice"):
        os.nice(NICENESS)
    stages = [each for each in arguments if not each.startswith("--")]
    if unknown := set(stages) - set(STAGES):
        raise SystemExit(f"warm_up: expected stages of {', '.join(STAGES)}, got {unknown.pop()}")
    if DESCENT in arguments:
        _run_descent(_scene(stages[0]))
    else:
        compile_loops(*stages)


if __name__ == "__main__":
    main(sys.argv[1:])
