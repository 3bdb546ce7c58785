"""How a training run reports on the command line."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from anchorflow_training.run import Report, TrainingRun

SHOWN = (
    "loss",
    "success",
    "any",
    "free",
    "feasible",
    "distance",
    "teacher_success",
    "samples_per_s",
    "seconds",
)


@contextmanager
def reported(run: TrainingRun, steps: int) -> Iterator[Report]:
    """A progress bar on a terminal, a plain line a report elsewhere."""
    if not (run.leads and sys.stdout.isatty()):
        yield _plain_line
        return
    columns = "step {task.completed}/{task.total}", "{task.fields[shown]}"
    with Progress(*map(TextColumn, columns), BarColumn(), TimeRemainingColumn()) as bar:
        task = bar.add_task("train", total=steps, completed=run.step, shown="")

        def report(step: int, row: dict[str, float]) -> None:
            if "loss" in row:
                bar.update(task, completed=step, shown=f"loss {row['loss']:.4f}")
            else:
                bar.console.print(_line(step, row))

        yield report


def _plain_line(step: int, row: dict[str, float]) -> None:
    typer.echo(_line(step, row))
    sys.stdout.flush()


def _line(step: int, row: dict[str, float]) -> str:
    """step 500 loss 0.4213 samples_per_s 840 seconds 312"""
    shown = (f"{name} {row[name]:.4g}" for name in SHOWN if name in row)
    return " ".join([f"step {step}", *shown])
