"""What `anchorflow bench …` says, shows and writes."""

from __future__ import annotations

from pathlib import Path

import typer

from anchorflow_benchmarks.report import Report


def say(line: str) -> None:
    """On standard error: tables alone go to standard output."""
    typer.echo(line, err=True)


def show_and_write(report: Report, folder: Path) -> None:
    """The tables on the terminal and as files in the folder."""
    report.show()
    for path in report.write(folder):
        say(str(path))
