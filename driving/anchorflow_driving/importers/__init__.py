"""Logs of other layouts. Each importer names file, field, expected and found where one is wrong."""

from __future__ import annotations

from enum import Enum
from pathlib import Path

from anchorflow_driving.errors import LogError


class Layout(str, Enum):
    COMMONROAD = "commonroad"
    NUSCENES = "nuscenes"
    ARGOVERSE = "av2"
    NAVSIM = "navsim"


SUFFIXES = {
    ".xml": Layout.COMMONROAD,
    ".parquet": Layout.ARGOVERSE,
    ".pkl": Layout.NAVSIM,
    ".pickle": Layout.NAVSIM,
}
# Files that identify a folder.
HELD = {
    "scene.json": Layout.NUSCENES,
    "v1.0-*/scene.json": Layout.NUSCENES,
    "scenario_*.parquet": Layout.ARGOVERSE,
}


def layout_of(path: Path) -> Layout:
    """The layout of a file by its suffix, of a folder by its files.

    Raises `LogError` if there is nothing there, or it looks like none of them.
    """
    if path.is_dir():
        found = next((HELD[held] for held in HELD if any(path.glob(held))), None)
        expected = f"a folder with {', '.join(HELD)}"
    elif path.exists():
        found = SUFFIXES.get(path.suffix.lower())
        expected = f"a folder or a file {', '.join(SUFFIXES)}, or --format"
    else:
        raise LogError(path, "file", expected="a file or a folder", found="nothing")
    if found is None:
        raise LogError(path, "format", expected=expected, found=path.suffix or "none of them")
    return found
