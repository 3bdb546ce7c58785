"""`anchorflow train`: a checkpoint from a dataset."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import torch
import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from anchorflow_cli.options import command_app
from anchorflow_models.flowmp.config import VARIANTS, L2Config
from anchorflow_training.batches import BatchConfig
from anchorflow_training.dataset import open_dataset
from anchorflow_training.trainer import CFMTrainer, TrainerConfig

app = command_app()


@app.command()
def train(
    dataset: Annotated[Path, typer.Argument(help="Folder that `anchorflow data make` wrote.")],
    *,
    out: Annotated[Path, typer.Option(help="Folder of the run; one that is there is resumed.")],
    steps: Annotated[int, typer.Option(min=1, help="Optimiser steps in all.")] = 12_000,
    variant: Annotated[str, typer.Option(help=f"Size: {', '.join(VARIANTS)}.")] = "small",
    scenes: Annotated[int, typer.Option(min=1, help="Scenes a batch.")] = 16,
    samples: Annotated[int, typer.Option(min=1, help="Samples a scene.")] = 32,
    learning_rate: Annotated[float, typer.Option(help="Peak learning rate.")] = 1e-3,
    seed: Annotated[int, typer.Option(min=0, help="Of weights, batches and noise.")] = 0,
    threads: Annotated[int, typer.Option(min=0, help="CPU threads; 0: all.")] = 0,
    bfloat16: Annotated[
        bool, typer.Option("--bfloat16", help="Mixed precision, for CPUs with AVX512-BF16.")
    ] = False,
) -> None:
    """Train the planner; stop it any time and start it again with the same words."""
    if threads:
        torch.set_num_threads(threads)
    torch.manual_seed(seed)
    config = TrainerConfig(
        steps=steps,
        learning_rate=learning_rate,
        bfloat16=bfloat16,
        batch=BatchConfig(scenes, samples, seed),
        model=L2Config(variant=variant),
    )
    trainer = CFMTrainer(config, open_dataset(dataset), out)
    columns = "step {task.completed}/{task.total}", "loss {task.fields[loss]:.4f}"
    with Progress(*map(TextColumn, columns), BarColumn(), TimeRemainingColumn()) as bar:
        task = bar.add_task("train", total=steps, completed=trainer.step, loss=float("nan"))
        trainer.fit(lambda step, terms: bar.update(task, completed=step, loss=terms["loss"]))
    typer.echo(f"{trainer.checkpoint_path}: step {trainer.step}")
