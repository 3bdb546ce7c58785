"""A server in a process of its own, and what it has cost."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from anchorflow_benchmarks.errors import BenchmarkError

CLI = "from anchorflow_cli.main import main; main()"


@dataclass(frozen=True)
class Served:
    """Where it answers, and its process."""

    url: str
    pid: int

    @property
    def cpu_s(self) -> float:
        """Processor time that it has used; 0 where /proc does not tell."""
        try:
            fields = Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            return 0.0
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def served(*options: str) -> Iterator[Served]:
    """`anchorflow serve` with these options on a free port, stopped at the end.

    Raises:
        BenchmarkError: it did not start.
    """
    command = (sys.executable, "-c", CLI, "serve", "--port", "0", *options)
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            line = process.stdout.readline()  # NAMES at URL (…)
            if " at " not in line:
                raise BenchmarkError(f"anchorflow serve {' '.join(options)} did not start")
            yield Served(line.partition(" at ")[2].split()[0], process.pid)
        finally:
            process.terminate()
