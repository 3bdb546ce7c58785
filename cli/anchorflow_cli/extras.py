"""A base install is numpy alone: what a command needs beyond it comes with an extra."""

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def needs_extra(extra: str, *, who: str) -> Iterator[None]:
    """Ends the program with one line that says what to install if an import in the block fails.

    A missing module of this project is a defect, not a missing extra, and is raised as it is.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name is None or error.name.startswith("anchorflow_"):
            raise
        raise SystemExit(
            f"{who} needs {error.name}, which is not installed: pip install 'anchorflow[{extra}]'"
        ) from error
