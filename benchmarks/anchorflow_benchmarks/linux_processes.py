"""What Linux tells of processes: which belong to which, what they hold and what they have used."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from anchorflow_benchmarks.errors import BenchmarkError

PROC = Path("/proc")
MB = 2.0**20
PARENT, USER_TICKS, SYSTEM_TICKS = 1, 11, 12  # in /proc/PID/stat, counted from behind the name


@dataclass(frozen=True)
class Held:
    """What a process holds: resident memory in MB, and open descriptors."""

    memory_mb: float
    descriptors: int

    @staticmethod
    def by(pid: int) -> Held:
        """Read from /proc. Raises `BenchmarkError` where the process or /proc is not there."""
        folder = PROC / str(pid)
        try:
            lines = (folder / "status").read_text().splitlines()
            descriptors = sum(1 for _ in (folder / "fd").iterdir())
        except OSError as error:
            raise BenchmarkError(f"cannot read what process {pid} holds: {error}") from error
        kilobytes = next(int(line.split()[1]) for line in lines if line.startswith("VmRSS:"))
        return Held(kilobytes * 1024 / MB, descriptors)


def cpu_seconds(pid: int) -> float:
    """Processor time that a process has used; 0 where /proc does not tell."""
    return (_stat(pid, USER_TICKS) + _stat(pid, SYSTEM_TICKS)) / os.sysconf("SC_CLK_TCK")


def descendants(pid: int, words: str) -> set[int]:
    """Processes that come from this one and have these words in their command line.

    Raises:
        BenchmarkError: there is no /proc.
    """
    if not (PROC / "self").exists():
        raise BenchmarkError("processes are found in /proc, which this system does not have")
    everybody = [int(entry.name) for entry in PROC.iterdir() if entry.name.isdecimal()]
    parents = {each: _stat(each, PARENT) for each in everybody}
    found = {each for each in parents if words in _command(each)}
    return {each for each in found if pid in _ancestors(each, parents)}


def _stat(pid: int, field: int) -> int:
    """0 where the process has gone meanwhile."""
    try:
        fields = (PROC / str(pid) / "stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0
    return int(fields[field])


def _command(pid: int) -> str:
    """Empty where the process has gone meanwhile, or has not been waited for."""
    try:
        return (PROC / str(pid) / "cmdline").read_text(errors="replace")
    except OSError:
        return ""


def _ancestors(pid: int, parents: dict[int, int]) -> set[int]:
    seen: set[int] = set()
    while (pid := parents.get(pid, 0)) and pid not in seen:
        seen.add(pid)
    return seen
