"""`anchorflow export`: a bundle from a checkpoint."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from anchorflow_cli.options import command_app
from anchorflow_cli.training_errors import one_line_errors
from anchorflow_client.contract import MapSpec, SamplerChoice, SamplerSpec
from anchorflow_export.bundle import BundleDescription, export_bundle
from anchorflow_models import L2Config
from anchorflow_service.manifest import LimitsEntry, RefineEntry
from anchorflow_training.checkpoint import load_checkpoint
from anchorflow_training.provenance import provenance
from anchorflow_training.restore import restore_model

app = command_app()


@app.command()
def export(
    checkpoint: Annotated[Path, typer.Argument(help="checkpoint.pt of a training run.")],
    *,
    out: Annotated[Path, typer.Option(help="Folder of the bundle.")],
    name: Annotated[str, typer.Option(help="Name of the bundle.")] = "flowmp-small",
    version: Annotated[str, typer.Option(help="Version of the bundle.")] = "0.1.0",
    method: Annotated[str, typer.Option(help="Default solver of the card.")] = "rk4",
    schedule: Annotated[
        str, typer.Option(help="Default schedule of the card: 8step, or a number of equal steps.")
    ] = "8",
    noise_scale: Annotated[
        float, typer.Option(min=0.1, max=3.0, help="Spread of the noise; 1: as in training.")
    ] = 1.0,
    robot_radius: Annotated[float, typer.Option(min=0.0, help="Default of the card [m].")] = 0.25,
    safety_margin: Annotated[
        float, typer.Option(min=0.0, help="Clearance that the descent asks for [m].")
    ] = 0.1,
    refine_steps: Annotated[int, typer.Option(min=1, help="Descents on each anchor.")] = 20,
) -> None:
    """Trace a trained planner to ONNX, prove that both agree, and write the bundle."""
    with one_line_errors():
        saved = load_checkpoint(checkpoint)
        model = restore_model(saved)
    model.prior.widen(noise_scale)
    config = model.config
    description = BundleDescription(
        name=name,
        version=version,
        planner="flowmp",
        T=config.num_steps,
        D=config.dim,
        limits=_limits(config, robot_radius),
        map=MapSpec(H=config.map_size, W=config.map_size, channels=config.map_channels),
        sampler=_sampler(method, schedule),
        refine=RefineEntry(
            smooth=True,
            project=True,
            safety_margin=safety_margin,
            guidance=0.0,
            steps=refine_steps,
            num_control_points=config.num_control_points,
            degree=config.degree,
        ),
        training={**provenance(saved), "noise_scale": noise_scale},
    )
    for difference in export_bundle(model, description, out=out):
        typer.echo(str(difference))
    typer.echo(f"{out}: {name} {version}")


def _limits(config: L2Config, robot_radius: float) -> LimitsEntry:
    return LimitsEntry(
        horizon_s=config.horizon_s,
        v_max=config.v_max,
        a_max=config.a_max,
        robot_radius=robot_radius,
    )


def _sampler(method: str, schedule: str) -> SamplerSpec:
    """The card's sampler in the words of a request; raises `InvalidRequest` as a request would."""
    steps = {"uniform": int(schedule)} if schedule.isdecimal() else schedule
    chosen = SamplerChoice.from_fields({"method": method, "schedule": steps})
    assert chosen.method is not None
    assert chosen.schedule is not None
    return SamplerSpec(chosen.method, chosen.schedule)
