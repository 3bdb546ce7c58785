"""Print result tables, and write them as JSON and Markdown with where they were measured."""

from __future__ import annotations

import json
import math
import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime, timezone
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.progress import Progress
from rich.table import Table

from anchorflow_benchmarks import BenchmarkError
from anchorflow_cli.extras import needs_extra
from anchorflow_trajectory.threads import usable_cores

Cell = str | float | int | None
Row = Mapping[str, Cell]

MISSING = "–"
MEASURING_WIDTH = 1000
PROGRAM = "anchorflow"
PACKAGES = ("numpy", "onnxruntime", "torch", "ompl")


@dataclass(frozen=True)
class ResultTable:
    """Rows of results; a column that a row lacks stays empty."""

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
            _markdown_row(self.columns),
            _markdown_row("---" if self.is_text(column) else "---:" for column in self.columns),
            *map(_markdown_row, self.cells),
        ]
        return "\n".join(lines)

    def to_json(self) -> dict[str, object]:
        return {"title": self.title, "note": self.note, "rows": [_json_row(r) for r in self.rows]}


@dataclass(frozen=True)
class Report:
    """The tables of a benchmark run and the settings that it ran with."""

    title: str
    about: Mapping[str, str]
    tables: Sequence[ResultTable]

    def show(self) -> None:
        """Print the tables; a wide table is never squeezed."""
        tables = [table.to_rich() for table in self.tables]
        # File and bundle names may look like markup.
        wide = Console(width=MEASURING_WIDTH, markup=False, emoji=False)
        console = Console(markup=False, emoji=False)
        console.width = max(console.width, *(wide.measure(table).maximum for table in tables))
        for table in tables:
            console.print(table)
            console.print()
        for key, value in self.about.items():
            console.print(f"{key}: {value}", highlight=False, style="dim")

    def write(self, folder: Path) -> list[Path]:
        """Write NAME.json and NAME.md to the folder; raise `BenchmarkError` if that fails."""
        name = self.title.lower().replace(" ", "_")
        header = dict(self.about)
        if command := typed_command():
            header = {"command": command, **header}
        tables = [table.to_json() for table in self.tables]
        markdown = [f"# {self.title}", "", *(f"- {key}: {value}" for key, value in header.items())]
        for table in self.tables:
            markdown += ["", table.to_markdown()]
        texts = {
            f"{name}.json": json.dumps({"about": header, "tables": tables}, indent=1),
            f"{name}.md": "\n".join(markdown),
        }
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for file, text in texts.items():
                (folder / file).write_text(text + "\n")
        except OSError as error:
            raise BenchmarkError(f"{error.filename}: {error.strerror}") from error
        return [folder / file for file in texts]


def report(
    title: str, about: Mapping[str, str], tables: Sequence[ResultTable], folder: Path
) -> None:
    """Show the tables and write them to the folder; raise `BenchmarkError` if that fails."""
    whole = Report(title, {**about, **circumstances()}, tables)
    whole.show()
    for path in whole.write(folder):
        say(str(path))


def record(
    bundles: Iterable[tuple[str, Path]], about: Mapping[str, str], first: ResultTable
) -> None:
    """Write rows of a report's first table, and its settings, into manifests, without times.

    bundles: the name of each in the first column, and its folder

    Raises `BundleError` if a manifest cannot be written.
    """
    with needs_extra("train", who="--record"):
        from anchorflow_export.bundle import record_quality
    key = first.columns[0]
    for name, folder in bundles:
        row = next(row for row in first.rows if row[key] == name)
        figures = {column: _rounded(row[column]) for column in row if column not in (key, "ms")}
        record_quality(folder, {**about, **figures})
        say(f"{folder}: recorded")


def say(line: str) -> None:
    """Print to standard error: standard output is for tables."""
    sys.stderr.write(f"{line}\n")


@contextmanager
def progress(title: str, total: int) -> Iterator[Callable[[int], None]]:
    """Show a progress bar on standard error; the function yielded advances it."""
    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(escape(title), total=total)
        yield lambda done: bar.advance(task, done)


def circumstances() -> dict[str, str]:
    """Return the date, commit, machine, load and versions for every result."""
    return {
        "date": datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M UTC"),
        "commit": _commit(),
        "machine": f"{_processor()}, {usable_cores()} of {os.cpu_count()} cores",
        "load": ", ".join(f"{mean:.2f}" for mean in os.getloadavg()) + " (1, 5, 15 min)",
        "versions": f"python {platform.python_version()}, "
        + ", ".join(f"{name} {_version(name)}" for name in PACKAGES),
    }


def typed_command() -> str | None:
    """Return `anchorflow bench …` as typed, without --out; None if another program runs."""
    path, *arguments = sys.argv
    if "--out" in arguments:
        place = arguments.index("--out")
        del arguments[place : place + 2]
    return shlex.join([PROGRAM, *arguments]) if Path(path).stem == PROGRAM else None


def formatted(value: Cell) -> str:
    """Return a cell as text with about three significant digits."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return MISSING
    if isinstance(value, float):
        size = abs(value)
        return f"{value:.{3 if size < 10 else 1 if size < 1000 else 0}f}"
    return str(value)


def tally(counts: Mapping[str, int]) -> str:
    """Return counts as one cell: `deadline_exceeded 4, overloaded 12`, or none."""
    return ", ".join(f"{name} {n}" for name, n in sorted(counts.items())) or "none"


def _markdown_row(cells: Iterable[str]) -> str:
    escaped = (cell.replace("|", r"\|") for cell in cells)
    return f"| {' | '.join(escaped)} |"


def _json_row(row: Row) -> dict[str, Cell]:
    return {
        key: None if isinstance(value, float) and math.isnan(value) else value
        for key, value in row.items()
    }


def _rounded(figure: Cell) -> Cell:
    if not isinstance(figure, float):
        return figure
    return round(figure, 4) if math.isfinite(figure) else None


def _commit() -> str:
    """Return the commit, with a plus if files differ from it; unknown outside a checkout."""
    try:
        head = _git("rev-parse", "--short", "HEAD")
        changed = _git("status", "--porcelain", "--untracked-files=no")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return f"{head}+" if changed else head


def _git(*arguments: str) -> str:
    command, folder = ("git", *arguments), Path(__file__).parent
    answer = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)
    return answer.stdout.strip()


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:  # only Linux has it
        return platform.processor() or platform.machine()
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.machine())


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "absent"
