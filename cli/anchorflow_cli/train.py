"""`anchorflow train`: a checkpoint from a dataset."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from anchorflow_cli.config_options import with_options
from anchorflow_cli.options import command_app
from anchorflow_cli.run_report import reported
from anchorflow_cli.training_errors import one_line_errors
from anchorflow_training.config_file import config_text, layered_config
from anchorflow_training.dataset import open_dataset
from anchorflow_training.settings import ConfigError
from anchorflow_training.trainer import CFMTrainer, TrainerConfig

app = command_app()

SHORT = {
    "model.variant": "--variant",
    "batch.scenes": "--scenes",
    "batch.samples": "--samples",
    "batch.seed": "--seed",
    "evaluation.held_out": "--held-out",
    "evaluation.patience": "--patience",
}


@app.command()
@with_options(TrainerConfig, SHORT)
def train(
    dataset: Annotated[Path, typer.Argument(help="Folder that `anchorflow data` wrote.")],
    *,
    out: Annotated[
        Path | None, typer.Option(help="Folder of the run; one that is there is resumed.")
    ] = None,
    config: Annotated[
        Path | None, typer.Option(help="YAML file of settings; options go over it.")
    ] = None,
    print_config: Annotated[
        bool, typer.Option("--print-config", help="Print the whole configuration and stop.")
    ] = False,
    bfloat16: Annotated[
        bool, typer.Option("--bfloat16", help="Short for --precision bfloat16.")
    ] = False,
    **given: Any,
) -> None:
    """Train the planner; stop it any time and start it again with the same words."""
    if bfloat16:
        given.setdefault("precision", "bfloat16")
    with one_line_errors():
        data = open_dataset(dataset)
        settings = layered_config(data, config, given)
        if print_config:
            typer.echo(config_text(settings), nl=False)
            return
        if out is None:
            raise ConfigError("--out: expected the folder of the run, got nothing")
        trainer = CFMTrainer(settings, data, out)
        if trainer.leads:
            out.mkdir(parents=True, exist_ok=True)
            (out / "config.yaml").write_text(config_text(settings))
            if trainer.evaluator is None:
                typer.echo("no scenes are held out (--held-out): nothing is evaluated", err=True)
        with reported(trainer, settings.steps) as report:
            trainer.fit(report)
    if trainer.leads:
        why = ": no progress, stopped early" if trainer.stopped else ""
        typer.echo(f"{trainer.checkpoint_path}: step {trainer.step}{why}")
