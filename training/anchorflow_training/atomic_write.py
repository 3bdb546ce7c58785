"""Files that are written whole or not at all, and the error where there is no place for one."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO


@contextmanager
def atomic_write(path: Path) -> Iterator[BinaryIO]:
    """A file to write in the block, which takes its place at the end of it.

    If the block fails or is interrupted, what is at `path` stays as it was, and no draft is left.

    Raises `OSError` if there is no place to write.
    """
    draft = path.with_name(f"{path.name}.{os.getpid()}")
    try:
        with draft.open("wb") as file:
            yield file
        draft.replace(path)
    finally:
        with suppress(OSError):
            draft.unlink(missing_ok=True)


@contextmanager
def writing(path: Path, refusal: type[Exception]) -> Iterator[None]:
    """Raise `refusal` with the path for an `OSError` of the block."""
    try:
        yield
    except OSError as error:
        raise refusal(f"{path}: expected a place to write ({error})") from error
