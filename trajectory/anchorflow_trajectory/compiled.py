"""Loops compiled to machine code, by numba.

A function marked `@compiled` is compiled for the types of its first call and kept on disk for the
processes that follow. It lets go of the interpreter's lock, so that threads run it side by side,
on other trajectories each; it starts no threads itself and keeps the order of its sums (no
`fastmath`), so that it gives the same bytes alone, in a batch and beside others. Division by zero
gives inf or NaN, as in numpy.

numba compiles anew when the file of a function has changed, but not when the file of one that it
calls has. So the machine code is kept in a folder that is named for the content of all of them: in
NUMBA_CACHE_DIR, or else beside the source. Where neither can be written, numba chooses. A constant
that a compiled function reads therefore stands in a file with a compiled function.
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
    settings.CACHE_DIR = _folder(chosen)
    try:
        dispatcher: Any = numba.njit(cache=True, nogil=True, error_model="numpy")(function)
    finally:
        settings.CACHE_DIR = chosen
    return dispatcher


@cache
def _folder(chosen: str) -> str:
    folder = Path(chosen or HERE.with_name("__pycache__")) / f"loops-{stamp(HERE.parent)}"
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
    sources = [path.read_bytes() for path in sorted(package.rglob("*.py"))]
    held = [HERE.read_bytes(), *(source for source in sources if MARK in source)]
    return sha256(b"\0".join(held)).hexdigest()[:12]
