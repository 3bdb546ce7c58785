"""Resources of the system for a service: a listening socket and enough open files."""

from __future__ import annotations

import ipaddress
import logging
import socket
import sys
from dataclasses import replace

from anchorflow_client.errors import AnchorFlowError
from anchorflow_service.http.connections import RESERVE, ConnectionLimits
from anchorflow_service.http.lifecycle import BACKLOG

if sys.platform != "win32":
    import resource

OTHER_FILES = 64
"""Open files beside connections: libraries, bundles, a zenoh network."""

logger = logging.getLogger(__name__)


class AddressError(AnchorFlowError):
    """The service cannot listen on the address."""


class OpenFilesError(AnchorFlowError):
    """The system allows too few open files."""


def listen(host: str, port: int) -> socket.socket:
    """Return a listening socket. Raises `AddressError` if the address is in use or not ours.

    The command makes the socket, not uvicorn: the printed address answers at once, and a port in
    use is reported before a bundle is loaded.
    """
    if not host:  # which sockets take for every address of this machine
        raise AddressError("--host: expected an address, such as 127.0.0.1, got ''")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        listener = socket.create_server((host, port), family=family)
        # Connections inherit this. asyncio sets it only for listeners that it makes; without it the
        # second packet of every response waits 40 ms for the client to acknowledge the first.
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return listener
    except OSError as error:
        reason = str(error.strerror).partition(" (while")[0]  # Python repeats the address there
        raise AddressError(f"cannot listen on {host}:{port}: {reason}") from error


def url_of(listener: socket.socket, *, tls: bool = False) -> str:
    """Return the URL of a listening socket."""
    host, port = listener.getsockname()[:2]
    scheme = "https" if tls else "http"
    return f"{scheme}://[{host}]:{port}" if ":" in host else f"{scheme}://{host}:{port}"


def is_loopback(listener: socket.socket) -> bool:
    """Return whether only this machine reaches the socket."""
    return ipaddress.ip_address(listener.getsockname()[0]).is_loopback


def within_open_files(limits: ConnectionLimits) -> ConnectionLimits:
    """Raise this process's limit on open files for the connections, or allow fewer of them.

    Raises `OpenFilesError` if there would be no connection left.
    """
    if sys.platform == "win32":
        return limits
    other = RESERVE + BACKLOG + OTHER_FILES
    needed = limits.max_connections + other
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY or soft >= needed:
        return limits
    allowed = needed if hard == resource.RLIM_INFINITY else min(needed, hard)
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (allowed, hard))
    except (ValueError, OSError):  # macOS has a limit below its hard one
        allowed = soft
    if allowed <= other:
        raise OpenFilesError(
            f"open files (ulimit -n): expected more than {other}, which are needed beside "
            f"connections, got {allowed}"
        )
    if allowed == needed:
        return limits
    fewer = replace(limits, max_connections=allowed - other)
    logger.warning(
        "--max-connections is %d in place of %d: of open files (ulimit -n) expected %d, got %d",
        fewer.max_connections,
        limits.max_connections,
        needed,
        allowed,
    )
    return fewer
