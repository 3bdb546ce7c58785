"""`anchorflow generate`: anchors of a checkpoint, in torch, without a bundle or a server."""

from __future__ import annotations

import hashlib
import secrets
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console

from anchorflow_cli.extras import needs_extra
from anchorflow_cli.options import (
    GoalOption,
    GoalVelocityOption,
    LayerOption,
    NumSamplesOption,
    PenaltyOption,
    SeedOption,
    StartOption,
    StartVelocityOption,
    StyleOption,
    UnknownIsFreeOption,
    Vector,
    command_app,
    end_states,
    file_option,
    picture_option,
)
from anchorflow_cli.plan import layers_of, table
from anchorflow_client.contract import AnchorBatch, ModelId
from anchorflow_client.errors import AnchorFlowError
from anchorflow_client.ros_map import MARGIN_M, RosMap, load_ros_map, map_window
from anchorflow_models.generation import AnchorTensors, GeneratorConfig, TrajectoryGenerator
from anchorflow_models.generation.scenes import DEFAULT_MOTION, DEFAULT_ROBOT_RADIUS
from anchorflow_training.checkpoint import Checkpoint, load_checkpoint, restore_flow
from anchorflow_training.distillation.teacher import student_schedule
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.scene import COST_PENALTY

app = command_app()

EMPTY_MAP_CELLS = 96
"""A side of the empty map: as many as the maps that `anchorflow data make` draws."""

DEFAULTS = GeneratorConfig()
OF_DATA = "as the run's data"


class GenerateError(AnchorFlowError):
    """The request cannot be generated; the message names the field."""


@app.command()
def generate(
    *,
    checkpoint: Annotated[Path, typer.Option(help="checkpoint.pt or best.pt of a training run.")],
    start: StartOption,
    goal: GoalOption,
    start_velocity: StartVelocityOption = None,
    goal_velocity: GoalVelocityOption = None,
    style: StyleOption = None,
    map_file: Annotated[
        Path | None, typer.Option("--map", help="The .yaml file of a ROS map; by default no walls.")
    ] = None,
    size: Annotated[
        float | None, typer.Option(help="Side of the square to plan in [m]; by the way's length.")
    ] = None,
    unknown_is_free: UnknownIsFreeOption = False,
    layer: LayerOption = None,
    cost_penalty: PenaltyOption = None,
    robot_radius: Annotated[
        float | None,
        typer.Option(help="Radius [m].", show_default=f"{OF_DATA}; {DEFAULT_ROBOT_RADIUS}"),
    ] = None,
    v_max: Annotated[
        float | None, typer.Option(help="Greatest speed [m/s].", show_default=OF_DATA)
    ] = None,
    a_max: Annotated[
        float | None, typer.Option(help="Greatest acceleration [m/s²].", show_default=OF_DATA)
    ] = None,
    horizon: Annotated[
        float | None,
        typer.Option(
            help="Duration [s] of every anchor.", show_default=f"each its own, or {OF_DATA}"
        ),
    ] = None,
    num_samples: NumSamplesOption = DEFAULTS.num_samples,
    seed: SeedOption = None,
    method: Annotated[
        str | None,
        typer.Option(
            help="euler, midpoint, heun, rk4, ab2 or the adaptive rk45.",
            show_default=f"{DEFAULTS.method}; a student's euler",
        ),
    ] = None,
    schedule: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|T,T,...",
            help="uniform, 8step or flow times from 0 to 1.",
            show_default=f"{DEFAULTS.schedule}; a student's own",
        ),
    ] = None,
    steps: Annotated[
        int | None,
        typer.Option(help="Of the uniform schedule.", show_default=f"{DEFAULTS.steps}"),
    ] = None,
    smooth: Annotated[bool, typer.Option(help="Fit splines that meet both ends.")] = True,
    project: Annotated[bool, typer.Option(help="Push anchors out of obstacles.")] = True,
    safety_margin: Annotated[
        float, typer.Option(help="Clearance [m] to aim at.")
    ] = DEFAULTS.safety_margin,
    barrier_rate: Annotated[
        float | None, typer.Option(help="Steer clear while drawing, at this rate; about 5.")
    ] = None,
    out: Annotated[Path | None, file_option("Arrays to write, .npz.")] = None,
    plot: Annotated[Path | None, picture_option("Picture to draw")] = None,
) -> None:
    """Draw anchors between two points; print a table, write them, draw them."""
    if layer and map_file is None:
        raise typer.BadParameter("expected --map, of whose size the pictures of --layer are")
    whole, seen = _seen(map_file, start, goal, size_m=size, unknown_is_free=unknown_is_free)
    x_curr, x_goal = end_states(start, goal, start_velocity, goal_velocity)
    seed = secrets.randbelow(2**63) if seed is None else seed
    saved = load_checkpoint(checkpoint)
    with _value_errors():
        config = GeneratorConfig(
            **_sampler(saved, method=method, schedule=schedule, steps=steps),
            num_samples=num_samples,
            smooth=smooth,
            project=project,
            safety_margin=safety_margin,
            barrier_rate=barrier_rate,
        )
        model = restore_flow(saved)
        usual: float = saved.data.get("robot_radius", DEFAULT_ROBOT_RADIUS)
        began = time.perf_counter()
        anchors = TrajectoryGenerator(model, config).generate(
            layers_of(whole, seen, layer),
            x_curr,
            x_goal,
            style,
            resolution=seen.resolution,
            origin=seen.origin,
            robot_radius=usual if robot_radius is None else robot_radius,
            motion=_motion(saved, v_max=v_max, a_max=a_max, horizon_s=horizon),
            cost_penalty=COST_PENALTY if cost_penalty is None else cost_penalty,
            seed=seed,
        )
    answer = _answer(
        anchors,
        seed=seed,
        model=_model_id(checkpoint, saved.step),
        milliseconds=1e3 * (time.perf_counter() - began),
    )
    Console(markup=False).print(table(answer))
    if out is not None:
        _write(out, answer)
    if plot is not None:
        with needs_extra("plot", who="anchorflow generate --plot"):
            from anchorflow_cli.plots import draw_anchors
        draw_anchors(answer, seen, start=start[:2], goal=goal[:2], path=plot)


def empty_map(start: Vector, goal: Vector, *, size_m: float | None) -> RosMap:
    """A free square of EMPTY_MAP_CELLS a side with its centre between both ends."""
    size_m = float(np.linalg.norm(goal - start)) + 2 * MARGIN_M if size_m is None else size_m
    return RosMap(
        values=np.zeros((EMPTY_MAP_CELLS, EMPTY_MAP_CELLS), np.int8),
        resolution=size_m / EMPTY_MAP_CELLS,
        origin=(start + goal) / 2 - size_m / 2,
        unknown_occupancy=0.0,
    )


def _seen(
    map_file: Path | None,
    start: Vector,
    goal: Vector,
    *,
    size_m: float | None,
    unknown_is_free: bool,
) -> tuple[RosMap, RosMap]:
    """Return the map and the window of it to plan in."""
    start, goal = start[:2], goal[:2]
    if map_file is None:
        free = empty_map(start, goal, size_m=size_m)
        return free, free
    ros_map = load_ros_map(map_file, unknown_is_free=unknown_is_free)
    return ros_map, map_window(ros_map, start, goal, size_m=size_m, option="--size")


def _sampler(
    saved: Checkpoint, *, method: str | None, schedule: str | None, steps: int | None
) -> dict[str, Any]:
    """Return the options over the defaults; a student's default is Euler on its own schedule."""
    of_student = student_schedule(saved)
    fields: dict[str, Any] = {}
    if of_student is not None:
        fields["method"] = "euler"
        if steps is None:
            fields["schedule"] = of_student
    times = None if schedule is None else _schedule(schedule)
    asked = {"method": method, "schedule": times, "steps": steps}
    return fields | {name: value for name, value in asked.items() if value is not None}


def _schedule(text: str) -> str | tuple[float, ...]:
    """A name as it is, numbers as flow times."""
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        return text


def _answer(
    anchors: AnchorTensors, *, seed: int, model: ModelId, milliseconds: float
) -> AnchorBatch:
    arrays = {name: tensor.numpy() for name, tensor in vars(anchors).items()}
    dt = arrays.pop("durations").astype(np.float64) / (anchors.trajectories.shape[-2] - 1)
    return AnchorBatch(
        arrays=arrays, dt=dt, seed=seed, model=model, timing_ms={"total": milliseconds}
    )


def _motion(
    saved: Checkpoint, *, v_max: float | None, a_max: float | None, horizon_s: float | None
) -> MotionLimits:
    """Return the options over the limits of the run's data."""
    usual = saved.data.get("limits")
    limits = MotionLimits(**usual) if usual else DEFAULT_MOTION
    asked = {"v_max": v_max, "a_max": a_max, "horizon_s": horizon_s}
    return replace(limits, **{name: value for name, value in asked.items() if value is not None})


def _model_id(checkpoint: Path, step: int) -> ModelId:
    digest = hashlib.sha256(checkpoint.read_bytes()).hexdigest()
    name = f"{checkpoint.absolute().parent.name}/{checkpoint.name}"
    return ModelId(name, f"of step {step}", digest)


def _write(path: Path, answer: AnchorBatch) -> None:
    """The answer's arrays with dt [N], the seed and the checkpoint's hash."""
    arrays = {
        name: getattr(answer, name)
        for name in ("trajectories", "velocities", "accelerations", "scores", "clearance", "safe")
    }
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("wb") as file:
            np.savez(file, **arrays, dt=answer.dt, seed=answer.seed, checkpoint=answer.model.sha256)
    except OSError as error:
        raise GenerateError(f"--out: {error}") from error


@contextmanager
def _value_errors() -> Iterator[None]:
    """Raise the generator's errors as `GenerateError`."""
    try:
        yield
    except ValueError as error:
        raise GenerateError(str(error)) from error
