"""`anchorflow data ...`: make datasets."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import Progress

from anchorflow_cli.options import command_app
from anchorflow_training.make_data import DataConfig, make_dataset

app = command_app()


@app.callback()
def data() -> None:
    """Make datasets to train on."""


@app.command()
def make(
    out: Annotated[Path, typer.Argument(help="Folder to write.")],
    *,
    scenes: Annotated[int, typer.Option(min=1, help="How many scenes.")] = 20_000,
    trajectories: Annotated[int, typer.Option(min=1, help="Trajectories kept a scene.")] = 16,
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same bytes.")] = 0,
    workers: Annotated[int, typer.Option(min=1, help="Processes.")] = os.cpu_count() or 1,
) -> None:
    """Draw random scenes and let the expert solve them."""
    config = DataConfig(scenes=scenes, trajectories=trajectories, seed=seed)
    with Progress() as bar:
        task = bar.add_task("scenes", total=scenes)
        meta = make_dataset(out, config, workers=workers, progress=lambda n: bar.advance(task, n))
    Console().print(
        f"{out}: {scenes} scenes; {meta['good_share']:.0%} of the expert's tries were good; "
        f"redrawn as unsolved: {sum(meta['unsolved'].values())}"
    )
