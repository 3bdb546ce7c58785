"""What `anchorflow bench …` says, shows and writes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import Progress

from anchorflow_benchmarks.machine import circumstances
from anchorflow_benchmarks.report import Cell, Report, ResultTable
from anchorflow_cli.extras import needs_extra


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


def record(
    bundles: Iterable[tuple[str, Path]], about: Mapping[str, str], first: ResultTable
) -> None:
    """Put rows of a report's first table into manifests, without what hangs on the machine.

    bundles: what the first column calls each, and its folder

    Raises:
        BundleError: a manifest cannot be written.
    """
    with needs_extra("train", who="--record"):
        from anchorflow_export.bundle import record_quality
    who = first.columns[0]
    for name, folder in bundles:
        row = next(row for row in first.rows if row[who] == name)
        figures = {key: value for key, value in row.items() if key not in (who, "ms")}
        record_quality(folder, {**about, **{key: _kept(each) for key, each in figures.items()}})
        say(f"{folder}: recorded")


def _kept(figure: Cell) -> Cell:
    """Four digits behind the point; None in place of NaN, which no JSON holds."""
    if not isinstance(figure, float):
        return figure
    return round(figure, 4) if math.isfinite(figure) else None


@contextmanager
def progress(title: str, total: int) -> Iterator[Callable[[int], None]]:
    """A bar on standard error; calls of what it gives move it on."""
    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(escape(title), total=total)
        yield lambda done: bar.advance(task, done)
