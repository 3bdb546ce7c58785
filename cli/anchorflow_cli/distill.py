"""`anchorflow distill`: a student of few evaluations from a trained checkpoint."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from anchorflow_cli.options import command_app, folder_option
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
from anchorflow_training.distillation.distiller import Distiller
from anchorflow_training.distillation.pairs import DistillConfig
from anchorflow_training.distillation.teacher import load_teacher
from anchorflow_training.settings import config_text, layers

app = command_app()

SHORT = {
    "model.layers": "--layers",
    "teacher.noise_scale": "--noise-scale",
    **SHARED_SHORT,
}


@app.command()
@with_settings([DistillConfig], SHORT)
def distill(
    checkpoint: Annotated[Path, typer.Argument(help="The teacher: checkpoint.pt of a run.")],
    dataset: Annotated[Path, typer.Argument(help="Folder that `anchorflow data` wrote.")],
    *,
    out: OutOption = None,
    pairs: Annotated[
        Path | None, folder_option("Folder of the teacher's pairs.", show_default="OUT/pairs")
    ] = None,
    config: ConfigOption = None,
    print_config: PrintConfigOption = False,
    bfloat16: Bfloat16Option = False,
    **given: Any,
) -> None:
    """Teach a student its teacher's anchors; stop it any time and start it again."""
    teacher, data = load_teacher(checkpoint), open_dataset(dataset)
    base = {"model": asdict(teacher.model.config)}
    settings = layers(DistillConfig, base, config, given_settings(given, bfloat16=bfloat16))
    if print_config:
        typer.echo(config_text(settings), nl=False)
        return
    folder = run_folder(out)
    teacher = teacher.widened(settings.teacher.noise_scale)
    student = Distiller(settings, data, folder, teacher=teacher, pairs=pairs or folder / "pairs")
    student.prepare(_pairs_line if student.leads else lambda *_: None)
    fit(student)


def _pairs_line(done: int, blocks: int) -> None:
    typer.echo(f"pairs {done}/{blocks}")
