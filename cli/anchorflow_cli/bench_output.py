"""What `anchorflow bench …` says, shows and writes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import typer
from rich.console import Console
from rich.progress import Progress

from anchorflow_benchmarks.machine import circumstances
from anchorflow_benchmarks.report import Report, ResultTable


def say(line: str) -> None:
    """On standard error: tables alone go to standard output."""
    typer.echo(line, err=True)


def report(
    title: str, about: Mapping[str, str], tables: Sequence[ResultTable], folder: Path
) -> None:
    """The tables on the terminal and as files in the folder, with where they were measured.

    Raises:
        BenchmarkError: a file cannot be written.
    """
    name = title.lower().replace(" ", "_")
    whole = Report(name, title, {**about, **circumstances()}, tables)
    whole.show()
    for path in whole.write(folder):
        say(str(path))


@contextmanager
def progress(title: str, total: int) -> Iterator[Callable[[int], None]]:
    """A bar on standard error; calls of what it gives move it on."""
    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=total)
        yield lambda done: bar.advance(task, done)
