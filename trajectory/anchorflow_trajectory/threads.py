"""The cores of this process, and how loops are spread over threads."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from pathlib import Path

Spread = Callable[[Callable[[int, int], None], int], None]
"""Calls work(begin, end) for parts of `count` anchors, on as many threads as it likes."""


def usable_cores(root: Path = Path("/")) -> int:
    """Cores that this process may run on at a time: by its affinity, and by its containers' quota.

    root: of the file system
    """
    # Linux alone has affinities.
    affine = getattr(os, "sched_getaffinity", None)
    cores = len(affine(0)) if affine else os.cpu_count() or 1
    return max(1, min([cores, *map(math.ceil, _quotas(root))]))


def _quotas(root: Path) -> Iterator[float]:
    """Yield how many cores' time each control group of this process allows, if it has a limit."""
    for group in _groups(root):
        words = _words(group / "cpu.max")  # "200000 100000", or "max 100000"
        words = words or [
            word for name in ("quota", "period") for word in _words(group / f"cpu.cfs_{name}_us")
        ]
        if len(words) == 2 and all(map(str.isdigit, words)):  # without a limit "max" or "-1"
            quota, period = map(int, words)
            yield quota / max(period, 1)


def _groups(root: Path) -> Iterator[Path]:
    """Yield the folders of this process's control groups, and of the groups that hold them."""
    mounted = root / "sys/fs/cgroup"
    for line in _lines(root / "proc/self/cgroup") or ["0::/"]:
        _, controllers, group = line.split(":", 2)
        if controllers and "cpu" not in controllers.split(","):
            continue
        for mount in {mounted, mounted / controllers, mounted / (controllers and "cpu")}:
            inside = mount / group.lstrip("/")  # absent if the container has its own root
            yield from {mount, inside, *(each for each in inside.parents if mount in each.parents)}


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text().splitlines()
    except OSError:
        return []


def _words(path: Path) -> list[str]:
    return " ".join(_lines(path)).split()


def in_one(work: Callable[[int, int], None], count: int) -> None:
    """A `Spread` over the calling thread alone."""
    work(0, count)
