"""How much of what was written for a client has not come to it yet."""

from __future__ import annotations

import asyncio
import struct
import sys

if sys.platform != "win32":
    import fcntl
    import termios


def held(transport: asyncio.Transport) -> int:
    """Bytes that this process still keeps, under TLS those that are encrypted already too."""
    protocol = getattr(transport, "_ssl_protocol", transport)
    below = getattr(protocol, "_transport", None)
    if protocol is None:  # asyncio lets go of it where a transport is closed a second time
        return 0
    size = transport.get_write_buffer_size()
    return size if below is None else size + below.get_write_buffer_size()


def untaken(transport: asyncio.Transport) -> int:
    """Those, and where the system can tell, the ones that its client has not acknowledged.

    The system takes more only once much of what it has is gone, which to a slow client may take
    minutes.
    """
    return held(transport) + _in_system(transport)


def _in_system(transport: asyncio.Transport) -> int:
    connection = transport.get_extra_info("socket")
    if sys.platform == "win32" or connection is None:
        return 0
    try:
        answer = fcntl.ioctl(connection.fileno(), termios.TIOCOUTQ, bytes(4))
    except OSError:
        return 0
    return struct.unpack("i", answer)[0]
