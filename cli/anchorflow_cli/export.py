"""`anchorflow export`: a bundle from a checkpoint."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from anchorflow_cli.options import command_app
from anchorflow_client.contract import MapSpec, SamplerSpec, uniform_schedule
from anchorflow_export.bundle import BundleDescription, export_bundle
from anchorflow_service.manifest import LimitsEntry, RefineEntry
from anchorflow_training.checkpoint import load_checkpoint
from anchorflow_training.provenance import provenance
from anchorflow_training.restore import restore_model

app = command_app()

ROBOT_RADIUS = 0.25  # m, the card's default; the clearance field carries the request's


@app.command()
def export(
    checkpoint: Annotated[Path, typer.Argument(help="checkpoint.pt of a training run.")],
    *,
    out: Annotated[Path, typer.Option(help="Folder of the bundle.")],
    name: Annotated[str, typer.Option(help="Name of the bundle.")] = "flowmp-small",
    version: Annotated[str, typer.Option(help="Version of the bundle.")] = "0.1.0",
    refine_steps: Annotated[int, typer.Option(min=1, help="Descents on each anchor.")] = 20,
) -> None:
    """Trace a trained planner to ONNX, prove that both agree, and write the bundle."""
    saved = load_checkpoint(checkpoint)
    model = restore_model(saved)
    config = model.config
    description = BundleDescription(
        name=name,
        version=version,
        planner="flowmp",
        T=config.num_steps,
        D=config.dim,
        limits=LimitsEntry(
            horizon_s=config.horizon_s,
            v_max=config.v_max,
            a_max=config.a_max,
            robot_radius=ROBOT_RADIUS,
        ),
        map=MapSpec(H=config.map_size, W=config.map_size, channels=config.map_channels),
        sampler=SamplerSpec("rk4", uniform_schedule(8)),
        refine=RefineEntry(
            smooth=True,
            project=True,
            safety_margin=0.1,
            guidance=0.0,
            steps=refine_steps,
            num_control_points=config.num_control_points,
            degree=config.degree,
        ),
        training=provenance(saved),
    )
    for difference in export_bundle(model, description, out=out):
        typer.echo(str(difference))
    typer.echo(f"{out}: {name} {version}")
