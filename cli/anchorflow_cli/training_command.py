"""What the commands that train share: options, the folder of a run, the run itself."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from anchorflow_cli.options import folder_option
from anchorflow_cli.run_report import reported
from anchorflow_training.config_file import config_text
from anchorflow_training.run import TrainingRun
from anchorflow_training.settings import ConfigError

OutOption = Annotated[
    Path | None, folder_option("Folder of the run; one that is there is resumed.")
]
ConfigOption = Annotated[
    Path | None, typer.Option(help="YAML file of settings; options go over it.")
]
PrintConfigOption = Annotated[
    bool, typer.Option("--print-config", help="Print the whole configuration and stop.")
]
Bfloat16Option = Annotated[bool, typer.Option("--bfloat16", help="Short for --precision bfloat16.")]

SHORT = {
    "batch.scenes": "--scenes",
    "batch.samples": "--samples",
    "batch.seed": "--seed",
    "evaluation.held_out": "--held-out",
    "evaluation.patience": "--patience",
}


def given_settings(given: dict[str, Any], *, bfloat16: bool) -> dict[str, Any]:
    """Settings of the command line by dotted path, short forms spelled out.

    Raises `ConfigError` where two of them contradict each other.
    """
    if bfloat16 and given.get("precision", "bfloat16") != "bfloat16":
        raise ConfigError(
            f"precision: expected --bfloat16 alone, got {given['precision']} beside it"
        )
    return {"precision": "bfloat16", **given} if bfloat16 else given


def run_folder(out: Path | None) -> Path:
    """The folder of a run, made once it begins; raises `ConfigError` where there is none."""
    if out is None:
        raise ConfigError("--out: expected the folder of the run, got nothing")
    return out


def carry_out(run: TrainingRun) -> None:
    """Fit, with the configuration in the run's folder and reports on the way."""
    if run.leads:
        _write_config(run)
        if not run.evaluates:
            typer.echo("no scenes are held out (--held-out): nothing is evaluated", err=True)
    with reported(run, run.run_config.steps) as report:
        run.fit(report)
    if run.leads:
        why = ": no progress, stopped early" if run.stopped else ""
        typer.echo(f"{run.checkpoint_path}: step {run.step}{why}")


def _write_config(run: TrainingRun) -> None:
    """Into the run's folder; raises `ConfigError` where there is no place to write."""
    file = run.out / "config.yaml"
    try:
        run.out.mkdir(parents=True, exist_ok=True)
        file.write_text(config_text(run.run_config))
    except OSError as error:
        raise ConfigError(f"{file}: expected a place to write ({error})") from error
