"""Loops compiled to machine code, by numba.

A function marked `@compiled` is compiled for the types of its first call and kept on disk for the
processes that follow. It lets go of the interpreter's lock, so that threads run it side by side,
on other trajectories each; it starts no threads itself and keeps the order of its sums (no
`fastmath`), so that it gives the same bytes alone, in a batch and beside others. Division by zero
gives inf or NaN, as in numpy.

numba compiles anew when the file of a function has changed, but not when the file of one that it
calls has. So the machine code is kept in a folder that is named for the content of all of them,
those of this package and of the one that marks the function: in NUMBA_CACHE_DIR, or else beside the
source. Where neither can be written, numba chooses. A constant that a compiled function reads
therefore stands in a file with a compiled function.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba.core import config

Function = TypeVar("Function", bound=Callable[..., Any])

HERE = Path(__file__)
MARK = b"@compiled\n"


def compiled(function: Function) -> Function:
    """The function as machine code; it takes and gives the same."""
    settings: Any = config
    chosen = settings.CACHE_DIR
    settings.CACHE_DIR = _folder(chosen, _package(function))
    try:
        dispatcher: Any = numba.njit(cache=True, nogil=True, error_model="numpy")(function)
    finally:
        settings.CACHE_DIR = chosen
    return dispatcher


def _package(function: Callable[..., Any]) -> Path:
    """Return the folder of the package whose module defines a function."""
    depth = function.__module__.count(".")
    return Path(function.__code__.co_filename).parents[max(depth - 1, 0)]


@cache
def _folder(chosen: str, package: Path = HERE.parent) -> str:
    folder = Path(chosen or package / "__pycache__") / f"loops-{stamp(package)}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return chosen
    return str(folder)


def kept() -> bool:
    """Whether there is machine code of these sources on disk."""
    folder = _folder(vars(config)["CACHE_DIR"])
    return bool(folder) and any(Path(folder).rglob("*.nbc"))


def stamp(package: Path) -> str:
    """Return a hash of this file and of all files below a folder with compiled functions."""
    folders = sorted({HERE.parent, package})
    sources = [path.read_bytes() for each in folders for path in sorted(each.rglob("*.py"))]
    held = [HERE.read_bytes(), *(source for source in sources if MARK in source)]
    return sha256(b"\0".join(held)).hexdigest()[:12]
