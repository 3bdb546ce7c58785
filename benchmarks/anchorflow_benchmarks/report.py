"""Results: tables on the terminal, the same in JSON and in Markdown."""

from __future__ import annotations

import json
import math
import shlex
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from anchorflow_benchmarks.errors import BenchmarkError

Cell = str | float | int | None
Row = Mapping[str, Cell]

NOTHING = "–"
MEASURING_WIDTH = 1000
PROGRAM = "anchorflow"


@dataclass(frozen=True)
class ResultTable:
    """Rows; a column that a row lacks is empty there."""

    title: str
    rows: Sequence[Row]
    note: str = ""

    @property
    def columns(self) -> list[str]:
        return list(dict.fromkeys(column for row in self.rows for column in row))

    @property
    def cells(self) -> list[list[str]]:
        return [[formatted(row.get(column)) for column in self.columns] for row in self.rows]

    def is_text(self, column: str) -> bool:
        return any(isinstance(row.get(column), str) for row in self.rows)

    def to_rich(self) -> Table:
        table = Table(
            title=self.title,
            caption=self.note or None,
            title_justify="left",
            caption_justify="left",
            box=SIMPLE_HEAD,
            pad_edge=False,
        )
        for column in self.columns:
            justify = "left" if self.is_text(column) else "right"
            table.add_column(column, justify=justify, no_wrap=True)
        for cells in self.cells:
            table.add_row(*cells)
        return table

    def to_markdown(self) -> str:
        lines = [
            f"## {self.title}",
            "",
            *([self.note, ""] if self.note else []),
            _line(self.columns),
            _line("---" if self.is_text(column) else "---:" for column in self.columns),
            *map(_line, self.cells),
        ]
        return "\n".join(lines)


@dataclass(frozen=True)
class Report:
    """What a benchmark found: how it was run, and its tables."""

    name: str
    title: str
    about: Mapping[str, str]
    tables: Sequence[ResultTable]

    def show(self) -> None:
        """On standard output; a wide table is never squeezed."""
        tables = [table.to_rich() for table in self.tables]
        # Names of files and bundles are text, whatever they look like.
        wide = Console(width=MEASURING_WIDTH, markup=False, emoji=False)
        console = Console(markup=False, emoji=False)
        console.width = max(console.width, *(wide.measure(table).maximum for table in tables))
        for table in tables:
            console.print(table)
            console.print()
        for key, value in self.about.items():
            console.print(f"{key}: {value}", highlight=False, style="dim")

    def write(self, folder: Path) -> list[Path]:
        """NAME.json and NAME.md in the folder, which is made.

        Raises:
            BenchmarkError: a file cannot be written.
        """
        texts = {f"{self.name}.json": self.to_json(), f"{self.name}.md": self.to_markdown()}
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for name, text in texts.items():
                (folder / name).write_text(text)
        except OSError as error:
            raise BenchmarkError(f"{error.filename}: {error.strerror}") from error
        return [folder / name for name in texts]

    @property
    def header(self) -> dict[str, str]:
        """What its files begin with: the command that was typed, if one was, and `about`."""
        command = typed_command()
        return ({"command": command} if command else {}) | dict(self.about)

    def to_json(self) -> str:
        tables = [
            {"title": table.title, "note": table.note, "rows": [_plain(r) for r in table.rows]}
            for table in self.tables
        ]
        return json.dumps({"about": self.header, "tables": tables}, indent=1) + "\n"

    def to_markdown(self) -> str:
        about = [f"- {key}: {value}" for key, value in self.header.items()]
        tables = [part for table in self.tables for part in ("", table.to_markdown())]
        return "\n".join([f"# {self.title}", "", *about, *tables]) + "\n"


def typed_command() -> str | None:
    """`anchorflow bench …` with its options as given, but for where the files lie; None where
    another program runs."""
    path, *arguments = sys.argv
    if "--out" in arguments:
        place = arguments.index("--out")
        del arguments[place : place + 2]
    return shlex.join([PROGRAM, *arguments]) if Path(path).stem == PROGRAM else None


def formatted(value: Cell) -> str:
    """A cell as text: about three digits that say something."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return NOTHING
    if isinstance(value, float):
        size = abs(value)
        return f"{value:.{3 if size < 10 else 1 if size < 1000 else 0}f}"
    return str(value)


def tally(counts: Mapping[str, int]) -> str:
    """Counts as one cell: `deadline_exceeded 4, overloaded 12`, or none."""
    return ", ".join(f"{name} {n}" for name, n in sorted(counts.items())) or "none"


def _line(cells: Iterable[str]) -> str:
    escaped = (cell.replace("|", r"\|") for cell in cells)
    return f"| {' | '.join(escaped)} |"


def _plain(row: Row) -> dict[str, Cell]:
    """JSON knows no NaN."""
    return {
        key: None if isinstance(value, float) and math.isnan(value) else value
        for key, value in row.items()
    }
