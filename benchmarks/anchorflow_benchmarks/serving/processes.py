"""The processes that belong to another one, as Linux lists them."""

from __future__ import annotations

from pathlib import Path

from anchorflow_benchmarks.errors import BenchmarkError

PROC = Path("/proc")


def descendants(pid: int, words: str) -> set[int]:
    """Processes that come from this one and have these words in their command line.

    Raises:
        BenchmarkError: there is no /proc.
    """
    if not (PROC / "self").exists():
        raise BenchmarkError("processes are found in /proc, which this system does not have")
    parents = {each: _parent(each) for each in _all()}
    found = {each for each in parents if words in _command(each)}
    return {each for each in found if pid in _ancestors(each, parents)}


def _all() -> list[int]:
    return [int(entry.name) for entry in PROC.iterdir() if entry.name.isdecimal()]


def _parent(pid: int) -> int:
    """0 where there is none, or the process has gone meanwhile."""
    try:
        return int((PROC / str(pid) / "stat").read_text().rpartition(")")[2].split()[1])
    except OSError:
        return 0


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
