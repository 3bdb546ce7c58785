"""`anchorflow average`: the mean of checkpoints."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from anchorflow_cli.options import command_app, file_option
from anchorflow_training.checkpoint import mean_checkpoint, save_checkpoint

app = command_app()


@app.command()
def average(
    checkpoints: Annotated[
        list[Path], typer.Argument(help="checkpoint.pt or best.pt of runs of one network.")
    ],
    *,
    out: Annotated[Path, file_option("File of the mean, a checkpoint itself.")],
) -> None:
    """Average the weights of checkpoints; all else in the mean is the last one's.

    The mean of runs that began with the same weights is often better than each.
    """
    if len(checkpoints) < 2:
        raise typer.BadParameter("expected two or more, got one", param_hint="CHECKPOINTS")
    save_checkpoint(out, mean_checkpoint(checkpoints))
    typer.echo(out)
