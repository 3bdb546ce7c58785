"""Errors of recordings, sensors and simulations."""

from __future__ import annotations

import tokenize
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from anchorflow_client.errors import AnchorFlowError

UNREADABLE = (
    OSError,
    ValueError,
    EOFError,
    OverflowError,
    MemoryError,
    RuntimeError,
    tokenize.TokenError,
    zlib.error,
    zipfile.BadZipFile,
)
"""Errors of numpy and zipfile on a damaged file of arrays."""


class LogError(AnchorFlowError):
    """A log that cannot be used: which file, which field, what was expected, what was found."""

    def __init__(self, path: Path | str, field: str, *, expected: str, found: str) -> None:
        self.path, self.field, self.expected, self.found = str(path), field, expected, found
        super().__init__(f"{path}: {field}: expected {expected}, found {found}")

    def __reduce__(self) -> tuple[Callable[..., LogError], tuple[str, str]]:
        # An exception is unpickled from its message alone by default.
        return partial(LogError, expected=self.expected, found=self.found), (self.path, self.field)


@contextmanager
def place_to_write(path: Path | str) -> Iterator[None]:
    """Raise `LogError` of the file for an `OSError` of the block."""
    try:
        yield
    except OSError as error:
        raise LogError(path, "file", expected="a place to write", found=str(error)) from error


class SensorError(AnchorFlowError):
    """A planner takes inputs that no log has, or plans poses that no log can judge."""


class SimulationError(AnchorFlowError):
    """SUMO failed; the message repeats its own."""
