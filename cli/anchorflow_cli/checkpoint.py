"""`anchorflow checkpoint`: make a checkpoint from a bundle."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from anchorflow_cli.options import command_app, file_option
from anchorflow_client.contract.batch import FUTURES
from anchorflow_export.adapter import ExportChoices
from anchorflow_export.planners import choices_of
from anchorflow_export.read_back import read_weights
from anchorflow_models.registry import planner_named
from anchorflow_models.v2x_vlm import V2XVLM
from anchorflow_service.bundle import Bundle, load_bundle
from anchorflow_training.checkpoint import (
    Checkpoint,
    CheckpointError,
    save_checkpoint,
    saved_model_config,
)

app = command_app()


@app.command()
def checkpoint(
    bundle: Annotated[Path, typer.Argument(help="Folder of a bundle.")],
    *,
    out: Annotated[Path, file_option("File of the checkpoint.")],
) -> None:
    """Read a bundle's weights back from its graphs, to train on or to export again.

    Parts that no graph holds, such as heads of the loss alone, begin anew and are named. The
    network of the others' futures is not read.
    """
    opened = load_bundle(bundle)
    saved = _without_weights(opened)
    config = saved_model_config(saved)
    model = planner_named(saved.planner).create(config).eval()
    if isinstance(model, V2XVLM):
        model.tokenizer = opened.file_path("tokenizer").read_bytes()
    choices = ExportChoices(**choices_of(opened))
    read = read_weights(opened, model, choices, planner=saved.planner)
    save_checkpoint(out, replace(saved, model=read.weights, average=read.weights))
    for difference in read.differences:
        typer.echo(str(difference))
    typer.echo(f"begin anew: {', '.join(read.anew) or 'none'}")
    if FUTURES in opened.manifest.graphs:
        typer.echo(f"not read: {FUTURES}, of another network; add it to a new bundle again")
    typer.echo(out)


def _without_weights(bundle: Bundle) -> Checkpoint:
    """Return what the manifest says of the run. Raises `CheckpointError` if it says too little."""
    told: dict[str, Any] = dict(bundle.manifest.training)
    if "model" not in told.get("config", {}):
        raise CheckpointError(
            f"{bundle.path}: expected training.config.model in the manifest, which says how large "
            "the network is, found none"
        )
    return Checkpoint(
        step=told.get("steps", 0),
        config=told["config"],
        data=told.get("data", {}),
        model={},
        average={},
        optimiser={},
        curve=[{"step": step, "loss": loss} for step, loss in told.get("loss", [])],
        teacher=told.get("teacher", {}),
        mean_of=told.get("mean_of", []),
        planner=bundle.manifest.planner,
    )
