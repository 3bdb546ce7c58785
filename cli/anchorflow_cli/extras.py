"""Report the extra that a command needs: a base install has numpy alone."""

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def needs_extra(extra: str, *, who: str) -> Iterator[None]:
    """End the program with the name of the extra to install if an import in the block fails.

    A missing module of this project is a defect, not a missing extra, and is raised again.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name is None or error.name.startswith("anchorflow_"):
            raise
        raise SystemExit(
            f"{who} needs {error.name}, which is not installed: pip install 'anchorflow[{extra}]'"
        ) from error
