"""Report the extra that a command needs: a base install has numpy alone."""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from anchorflow_client.errors import how_to_install


@contextmanager
def needs_extra(
    extra: str, *, who: str, summary: str = "", arguments: Sequence[str] = ()
) -> Iterator[None]:
    """End the program with the name of the extra to install if an import in the block fails.

    If the arguments ask for help, it prints the summary and the extra, and ends well. A missing
    module of this project is a defect, not a missing extra, and is raised again.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name is None or error.name.startswith("anchorflow_"):
            raise
        install = how_to_install(extra)
        if "--help" in arguments:
            sys.stdout.write(
                f"Usage: {who} [OPTIONS]\n\n  {summary}\n\n"
                f"Its options are listed where its packages are installed: {install}\n"
            )
            raise SystemExit(0) from error
        raise SystemExit(f"{who} needs {error.name}, which is not installed: {install}") from error
