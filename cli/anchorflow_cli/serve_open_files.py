"""`anchorflow serve`: as many open files as its connections need, or fewer connections."""

from __future__ import annotations

import logging
import sys
from dataclasses import replace

from anchorflow_cli.serve_options import ServeOptionError
from anchorflow_service.http.connections import RESERVE, ConnectionLimits
from anchorflow_service.http.lifecycle import ACCEPTED_AT_A_TIME

if sys.platform != "win32":
    import resource

OTHER_FILES = 64
"""Beside connections: libraries and bundles that are read, a zenoh network."""

logger = logging.getLogger(__name__)


def within_open_files(limits: ConnectionLimits) -> ConnectionLimits:
    """The limits, with fewer connections where the system does not allow files for all of them.

    It is asked for as many as are needed first, in this process and those that it starts.

    Raises:
        ServeOptionError: there would be none.
    """
    if sys.platform == "win32":
        return limits
    beside = RESERVE + ACCEPTED_AT_A_TIME + OTHER_FILES
    needed = limits.max_connections + beside
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY or soft >= needed:
        return limits
    allowed = needed if hard == resource.RLIM_INFINITY else min(needed, hard)
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (allowed, hard))
    except (ValueError, OSError):  # macOS has a limit below its hard one
        allowed = soft
    if allowed <= beside:
        raise ServeOptionError(
            f"open files (ulimit -n): expected more than {beside}, which are needed beside "
            f"connections, got {allowed}"
        )
    if allowed == needed:
        return limits
    fewer = replace(limits, max_connections=allowed - beside)
    logger.warning(
        "--max-connections is %d in place of %d: of open files (ulimit -n) expected %d, got %d",
        fewer.max_connections,
        limits.max_connections,
        needed,
        allowed,
    )
    return fewer
