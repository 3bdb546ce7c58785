"""The head of an answer, which leaves together with what follows it."""

from __future__ import annotations

import asyncio

INTERIM = b"HTTP/1.1 1"
"""How an answer begins that another one follows, such as 100 Continue."""


class JoinedHead:
    """A transport for one answer, whose head leaves together with what follows it.

    One call of the system less, and a client is woken once.
    """

    def __init__(self, transport: asyncio.Transport) -> None:
        self._transport = transport
        self._head: bytes | None = None
        self._has_begun = False

    def write(self, data: bytes) -> None:
        """Send it, the head before it; keep it, where it is the head."""
        if data.startswith(INTERIM) or self._has_begun:
            head, self._head = self._head, None
            self._transport.write(data if head is None else head + data)
        else:
            self._head, self._has_begun = data, True

    def flush(self) -> None:
        """The answer is complete: send the head where nothing followed it."""
        if self._head is not None:
            self.write(b"")

    def close(self) -> None:
        """Once all is sent."""
        self.flush()
        self._transport.close()

    def is_closing(self) -> bool:
        """Whether it takes no more."""
        return self._transport.is_closing()
