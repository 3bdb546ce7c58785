"""`anchorflow train`: a checkpoint from a dataset."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from anchorflow_cli.options import command_app
from anchorflow_cli.training_options import (
    SHORT as SHARED_SHORT,
)
from anchorflow_cli.training_options import (
    Bfloat16Option,
    ConfigOption,
    OutOption,
    PrintConfigOption,
    fit,
    given_settings,
    run_folder,
    with_settings,
)
from anchorflow_training.dataset import open_dataset
from anchorflow_training.planners import TRAININGS, training_of
from anchorflow_training.settings import config_text, layers
from anchorflow_training.v2x.dataset import refuse_pairs

app = command_app()

SHORT = {"model.variant": "--variant", **SHARED_SHORT}


@app.command()
@with_settings([training.config for training in TRAININGS.values()], SHORT)
def train(
    dataset: Annotated[Path, typer.Argument(help="Folder that `anchorflow data` wrote.")],
    *,
    planner: Annotated[
        str | None,
        typer.Option(metavar="|".join(TRAININGS), help="Which.", show_default="the file's; flowmp"),
    ] = None,
    out: OutOption = None,
    config: ConfigOption = None,
    print_config: PrintConfigOption = False,
    bfloat16: Bfloat16Option = False,
    **given: Any,
) -> None:
    """Train a planner; stop it any time and start it again with the same words."""
    training = training_of(planner, config)
    if training.open_data is open_dataset:
        refuse_pairs(dataset)
    data = training.open_data(dataset)
    base = {"model": training.run.model_settings(data)}
    settings = layers(training.config, base, config, given_settings(given, bfloat16=bfloat16))
    if print_config:
        typer.echo(config_text(settings), nl=False)
        return
    fit(training.run(settings, data, run_folder(out)))
