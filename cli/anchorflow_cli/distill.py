"""`anchorflow distill`: a student of few evaluations from a trained checkpoint."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from anchorflow_cli.config_options import with_options
from anchorflow_cli.options import command_app
from anchorflow_cli.run_report import reported
from anchorflow_cli.training_errors import one_line_errors
from anchorflow_training.config_file import config_text, layers
from anchorflow_training.dataset import open_dataset
from anchorflow_training.distillation.config import DistillConfig
from anchorflow_training.distillation.distiller import Distiller
from anchorflow_training.distillation.teacher import load_teacher
from anchorflow_training.settings import ConfigError

app = command_app()

SHORT = {
    "model.layers": "--layers",
    "batch.scenes": "--scenes",
    "batch.samples": "--samples",
    "batch.seed": "--seed",
    "teacher.noise_scale": "--noise-scale",
    "evaluation.held_out": "--held-out",
    "evaluation.patience": "--patience",
}


@app.command()
@with_options(DistillConfig, SHORT)
def distill(
    checkpoint: Annotated[Path, typer.Argument(help="The teacher: checkpoint.pt of a run.")],
    dataset: Annotated[Path, typer.Argument(help="Folder that `anchorflow data` wrote.")],
    *,
    out: Annotated[
        Path | None, typer.Option(help="Folder of the run; one that is there is resumed.")
    ] = None,
    pairs: Annotated[
        Path | None, typer.Option(help="Folder of the teacher's pairs.", show_default="OUT/pairs")
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
    """Teach a student its teacher's anchors; stop it any time and start it again."""
    if bfloat16:
        given.setdefault("precision", "bfloat16")
    with one_line_errors():
        data, teacher = open_dataset(dataset), load_teacher(checkpoint)
        base = {"model": asdict(teacher.model.config)}
        settings = layers(DistillConfig, base, config, given)
        if print_config:
            typer.echo(config_text(settings), nl=False)
            return
        if out is None:
            raise ConfigError("--out: expected the folder of the run, got nothing")
        teacher = teacher.widened(settings.teacher.noise_scale)
        student = Distiller(settings, data, out, teacher=teacher, pairs=pairs or out / "pairs")
        if student.leads:
            out.mkdir(parents=True, exist_ok=True)
            (out / "config.yaml").write_text(config_text(settings))
        student.prepare(_pairs_line if student.leads else lambda *_: None)
        with reported(student, settings.steps) as report:
            student.fit(report)
    if student.leads:
        typer.echo(f"{student.checkpoint_path}: step {student.step}")


def _pairs_line(done: int, blocks: int) -> None:
    typer.echo(f"pairs {done}/{blocks}")
