"""The socket that a service listens on, and its address in words."""

from __future__ import annotations

import ipaddress
import socket

from anchorflow_client.errors import AnchorFlowError


class AddressError(AnchorFlowError):
    """The address cannot be listened on."""


def listen(host: str, port: int) -> socket.socket:
    """A listening socket. Raises `AddressError` where the address is taken or not this machine's.

    Made here and not by uvicorn, so that the address that is printed answers, and a port in use
    is one line, before a bundle is loaded for nothing.
    """
    if not host:  # which sockets take for every address of this machine
        raise AddressError("--host: expected an address, such as 127.0.0.1, got ''")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        listener = socket.create_server((host, port), family=family)
        # Connections inherit it. asyncio sets it for listeners of its own alone, and without it the
        # second packet of every answer waits 40 ms for the client to acknowledge the first.
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return listener
    except OSError as error:
        reason = str(error.strerror).partition(" (while")[0]  # Python repeats the address there
        raise AddressError(f"cannot listen on {host}:{port}: {reason}") from error


def url_of(listener: socket.socket, *, tls: bool = False) -> str:
    host, port = listener.getsockname()[:2]
    scheme = "https" if tls else "http"
    return f"{scheme}://[{host}]:{port}" if ":" in host else f"{scheme}://{host}:{port}"


def is_loopback(listener: socket.socket) -> bool:
    """Whether nobody but this machine reaches it."""
    return ipaddress.ip_address(listener.getsockname()[0]).is_loopback
