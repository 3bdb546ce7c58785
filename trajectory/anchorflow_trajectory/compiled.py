"""Loops compiled to machine code, by numba.

A function marked `@compiled` is compiled for the types of its first call and kept on disk for the
processes that follow. One marked `@compiled_part` is compiled into those that call it, which costs
less than half: from Python it is the plain, slow function. Compiled functions let go of the
interpreter's lock, so that threads run them side by side, on other trajectories each; they start no
threads themselves and keep the order of their sums (no `fastmath`), so that they give the same
bytes alone, in a batch and beside others. Division by zero gives inf or NaN, as in numpy.

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
from numba.extending import register_jitable

Function = TypeVar("Function", bound=Callable[..., Any])

HERE = Path(__file__)
MARKS = b"@compiled\n", b"@compiled_part\n"
OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}


def compiled(function: Function) -> Function:
    """Return the function as machine code; it takes and gives the same."""
    settings: Any = config
    chosen = settings.CACHE_DIR
    settings.CACHE_DIR = _folder(chosen, _package(function))
    try:
        dispatcher: Any = numba.njit(cache=True, **OPTIONS)(function)
    finally:
        settings.CACHE_DIR = chosen
    return dispatcher


def compiled_part(function: Function) -> Function:
    """Return the function itself, which compiled functions can call as machine code."""
    return register_jitable(**OPTIONS)(function)


def _package(function: Callable[..., Any]) -> Path:
    """Return the folder of the package whose module defines a function."""
    depth = function.__module__.count(".")
    return Path(function.__code__.co_filename).parents[max(depth - 1, 0)]


def code_folder() -> Path | None:
    """Return the folder of this package's machine code; None if numba chooses it."""
    chosen = vars(config)["CACHE_DIR"]
    folder = _folder(chosen)
    return None if folder == chosen else Path(folder)


@cache
def _folder(chosen: str, package: Path = HERE.parent) -> str:
    folder = Path(chosen or package / "__pycache__") / f"loops-{stamp(package)}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return chosen
    return str(folder)


def stamp(package: Path) -> str:
    """Return a hash of this file and of all files below a folder with compiled functions."""
    folders = sorted({HERE.parent, package})
    sources = [path.read_bytes() for each in folders for path in sorted(each.rglob("*.py"))]
    held = [source for source in sources if any(mark in source for mark in MARKS)]
    return sha256(b"\0".join([HERE.read_bytes(), *held])).hexdigest()[:12]
