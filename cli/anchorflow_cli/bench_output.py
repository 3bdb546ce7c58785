"""What `anchorflow bench …` says, shows and writes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import typer
from rich.console import Console
from rich.progress import Progress

from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.report import Report


def say(line: str) -> None:
    """On standard error: tables alone go to standard output."""
    typer.echo(line, err=True)


def show_and_write(report: Report, folder: Path) -> None:
    """The tables on the terminal and as files in the folder."""
    report.show()
    for path in report.write(folder):
        say(str(path))


@contextmanager
def progress(title: str, total: int) -> Iterator[Callable[[int], None]]:
    """A bar on standard error; calls of what it gives move it on."""
    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=total)
        yield lambda done: bar.advance(task, done)


def whole_numbers(text: str, option: str) -> list[int]:
    """`1,16,64` as numbers above 0; raises `BenchmarkError`."""
    parts = text.split(",")
    if not all(part.isdecimal() and int(part) > 0 for part in parts):
        raise BenchmarkError(f"{option}: expected whole numbers above 0 such as 1,16, got {text!r}")
    return [int(part) for part in parts]
