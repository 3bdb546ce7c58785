"""`anchorflow export`: make a bundle from a checkpoint."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from anchorflow_cli.options import command_app, folder_option
from anchorflow_client.contract import SamplerChoice
from anchorflow_client.contract.fields import LIMITS
from anchorflow_export.adapter import ExportChoices
from anchorflow_export.bundle import BundleDescription, export_bundle
from anchorflow_export.futures import add_futures
from anchorflow_export.planners import adapter_of, check_used, choices_of
from anchorflow_export.quantization import quantize_bundle, rounded_graphs
from anchorflow_export.tracing import ExportError
from anchorflow_models.futures import FuturesNetwork
from anchorflow_service.bundle import load_bundle
from anchorflow_training.checkpoint import Checkpoint, load_checkpoint, provenance, restore_model
from anchorflow_training.distillation.teacher import student_schedule
from anchorflow_trajectory.finish.refiner import DESCENT_RATE
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.ode.schedule import Schedule

app = command_app()


@app.command()
def export(
    checkpoint: Annotated[Path, typer.Argument(help="checkpoint.pt of a training run.")],
    *,
    out: Annotated[
        Path, folder_option("Folder of the bundle; of futures, the bundle that they are added to.")
    ],
    name: Annotated[
        str | None, typer.Option(help="Name of the bundle.", show_default="flowmp-small, …")
    ] = None,
    version: Annotated[
        str | None,
        typer.Option(help="Version of the bundle.", show_default="0.1.0; with futures as it is"),
    ] = None,
    method: Annotated[
        str | None,
        typer.Option(help="Default solver of the card.", show_default="rk4; a student's euler"),
    ] = None,
    schedule: Annotated[
        str | None,
        typer.Option(
            metavar="8step|COUNT|T,T,...",
            help="Default schedule of the card: 8step, a number of equal steps, or flow times.",
            show_default="8; a student's own",
        ),
    ] = None,
    noise_scale: Annotated[
        float | None,
        typer.Option(
            min=0.1, max=3.0, help="Spread of the noise; 1: as in training.", show_default="1"
        ),
    ] = None,
    robot_radius: Annotated[
        float | None,
        typer.Option(
            min=0.0, help="Default of the card [m].", show_default="that of the data; 0.25"
        ),
    ] = None,
    safety_margin: Annotated[
        float | None,
        typer.Option(min=0.0, help="Clearance that the descent asks for [m].", show_default="0.1"),
    ] = None,
    refine_steps: Annotated[
        int | None, typer.Option(min=1, help="Descents on each anchor.", show_default="20")
    ] = None,
    refine_rate: Annotated[
        float | None,
        typer.Option(min=0.001, help="Of the first descent [m].", show_default=f"{DESCENT_RATE}"),
    ] = None,
    score: Annotated[
        str | None,
        typer.Option(
            metavar="NAME=NUMBER,...",
            help="GoalFlow: weights of a trajectory's score, such as progress=12,route=0.3.",
        ),
    ] = None,
    goal_inputs: Annotated[
        bool,
        typer.Option("--goal-inputs", help="GoalFlow: requests may bring goals and score weights."),
    ] = False,
    int8: Annotated[
        bool, typer.Option("--int8", help="Field and encoder in eight bits: faster, rounded.")
    ] = False,
    like: Annotated[
        Path | None,
        typer.Option(help="Bundle whose choices hold where no option says otherwise."),
    ] = None,
    float32: Annotated[
        bool, typer.Option("--float32", help="In float32, though the bundle of --like is not.")
    ] = False,
) -> None:
    """Trace a trained planner to ONNX, prove that both agree, and write the bundle."""
    saved = load_checkpoint(checkpoint, in_file=True)
    model = restore_model(saved)
    asked = {
        "sampler": method or schedule,
        "noise_scale": noise_scale,
        "robot_radius": robot_radius,
        "safety_margin": safety_margin,
        "refine_steps": refine_steps,
        "refine_rate": refine_rate,
        "score": score and _weights(score),
        "goal_inputs": goal_inputs or None,
    }
    asked = {name: value for name, value in asked.items() if value is not None}
    check_used(saved.planner, [*asked, *(["int8"] if int8 else [])])
    if isinstance(model, FuturesNetwork):
        for option, value in (("name", name), ("like", like)):
            if value is not None:
                raise ExportError(f"{option}: expected none, as {out} has its own, got {value}")
        training = provenance(saved)
        with _sigterm_cleans_up():
            for difference in add_futures(model, out, training=training, version=version):
                typer.echo(str(difference))
        typer.echo(f"{out}: with futures")
        return
    if int8 and float32:
        raise ExportError("float32: expected int8 or float32, got both")
    own_name, rounded, made = _like(like, saved)
    if "sampler" in asked or "sampler" not in made:
        asked["sampler"] = _sampler(method, schedule, student_schedule(saved))
    choices = ExportChoices(**{**_limits(saved), **made, **asked})
    description = BundleDescription(
        name=own_name if name is None else name,
        version=version or "0.1.0",
        planner=saved.planner,
        training={**provenance(saved), **_chosen(choices)},
    )
    adapter = adapter_of(saved.planner, model, choices)
    with _sigterm_cleans_up():
        for difference in export_bundle(adapter, description, out=out):
            typer.echo(str(difference))
        if int8 or (rounded and not float32):
            typer.echo(str(quantize_bundle(out, like=rounded)))
    typer.echo(f"{out}: {description.name} {description.version}")


@contextmanager
def _sigterm_cleans_up() -> Iterator[None]:
    """End the block on SIGTERM as on an error, so that no half-written files are left."""

    def end(number: int, _: object) -> None:
        raise SystemExit(128 + number)

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _like(path: Path | None, checkpoint: Checkpoint) -> tuple[str, dict[str, Any], dict[str, Any]]:
    """Return the name, the graphs in eight bits, and the choices of a bundle, if there is one.

    Raises `ExportError` if it is of another planner than the checkpoint.
    """
    if path is None:
        return _name(checkpoint), {}, {}
    bundle = load_bundle(path)
    manifest = bundle.manifest
    if manifest.planner != checkpoint.planner:
        expected = f"expected a bundle of {checkpoint.planner}, got one of {manifest.planner}"
        raise ExportError(f"like: {path}: {expected}")
    return manifest.name, rounded_graphs(bundle), choices_of(bundle)


def _name(checkpoint: Checkpoint) -> str:
    """Return the planner's name, with its variant if it has one: flowmp-small."""
    variant = checkpoint.config["model"].get("variant")
    return f"{checkpoint.planner}-{variant}" if variant else checkpoint.planner


def _chosen(choices: ExportChoices) -> dict[str, Any]:
    """Return the choices that change graphs and stand nowhere else in the manifest."""
    scored = {"score": dict(choices.score)} if choices.score else {}
    return {"noise_scale": choices.noise_scale, **scored}


def _limits(checkpoint: Checkpoint) -> dict[str, Any]:
    """Return the limits and robot of the card, if the planner's data has any."""
    data = checkpoint.data
    told = {name: data[name] for name in ("robot_radius",) if name in data}
    if data.get("limits"):
        ranges = data.get("ranges") or {}
        told["limits"] = MotionLimits(**data["limits"])
        told["ranges"] = {n: tuple(ranges[n]) for n in LIMITS if n in ranges}
    return told


def _weights(text: str) -> dict[str, float]:
    """Parse "progress=12,route=0.3"."""
    try:
        return {name: float(value) for name, value in (p.split("=") for p in text.split(","))}
    except ValueError:
        raise typer.BadParameter(
            f"expected NAME=NUMBER,..., got {text!r}", param_hint="--score"
        ) from None


def _sampler(
    method: str | None, schedule: str | None, of_student: Schedule | None
) -> SamplerChoice:
    """Return the card's sampler; raise `InvalidRequest` as for a request."""
    fields: dict[str, Any] = {}
    if of_student is not None:
        fields = {"method": "euler", "schedule": [*of_student]}
    if method is not None:
        fields["method"] = method
    if schedule is not None:
        fields["schedule"] = _schedule(schedule)
    return SamplerChoice.from_fields(fields)


def _schedule(text: str) -> Any:
    """Parse a count as equal steps, numbers as flow times; return a name unchanged."""
    if text.isdecimal():
        return {"uniform": int(text)}
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        return text
