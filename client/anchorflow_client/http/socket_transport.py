"""HTTP over one socket that is kept open."""

from __future__ import annotations

import http.client
import os
import socket
import ssl
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cached_property

from anchorflow_client.http.answer_parser import AnswerParser
from anchorflow_client.http.transport import Address, HttpAnswer, translated, unreachable

HEARD_BYTES = 256 * 2**10
"""At most, at a time."""
HUNG_UP = (ConnectionError, ssl.SSLEOFError, ssl.SSLZeroReturnError)
"""What is met on a connection that the service has closed."""


class SocketTransport:
    """One connection, kept alive; opened again once where the service had closed an idle one.

    Threads may share it, and take turns. After a fork each process has a connection of its own.
    """

    def __init__(self, url: str, *, connect_timeout_s: float) -> None:
        """Opens nothing yet.

        Raises:
            ValueError: `url` is no address of a service.
        """
        self._url = url
        self._address = Address.of(url)
        self._connect_timeout_s = float(connect_timeout_s)
        self._locks: dict[int, threading.Lock] = {}
        self._socket: socket.socket | None = None
        self._pid = os.getpid()
        # Kept: new memory of that size is taken from the system and given back each time.
        self._heard = memoryview(bytearray(HEARD_BYTES))

    def send(
        self,
        method: str,
        path: str,
        headers: Mapping[str, str],
        body: bytes | None,
        timeout_s: float,
    ) -> HttpAnswer:
        """Send and wait; `timeout_s` bounds each wait for the service's next bytes."""
        head = self._address.head(method, path, headers, body)
        with self._turn(), self._translated_errors(timeout_s):
            if self._socket is not None:
                try:
                    return self._exchange(self._socket, head, body, timeout_s)
                except HUNG_UP:  # while it was idle
                    self._disconnect()
            return self._exchange(self._connect(), head, body, timeout_s)

    def close(self) -> None:
        """Close the connection; a later `send` opens it again."""
        with self._turn():
            self._disconnect()

    @contextmanager
    def _turn(self) -> Iterator[None]:
        """One thread's at a time, on no other process's connection."""
        pid = os.getpid()
        # A lock that another thread held at a fork is held for ever in the child.
        with self._locks.setdefault(pid, threading.Lock()):
            if self._pid != pid:
                self._disconnect()  # the child's copy; the parent's stays open
                self._pid = pid
            yield

    def _exchange(
        self, connection: socket.socket, head: bytes, body: bytes | None, timeout_s: float
    ) -> HttpAnswer:
        connection.settimeout(timeout_s)
        # A service that refuses a large body stops reading it: its answer may be here already.
        with suppress(*HUNG_UP):
            _send_all(connection, head, body or b"")
        parser = AnswerParser()
        while parser.answer is None:
            if size := connection.recv_into(self._heard):
                parser.feed(self._heard[:size])
            else:
                parser.end()
        if not parser.keeps_alive:
            self._disconnect()
        return parser.answer

    def _connect(self) -> socket.socket:
        address = self._address
        try:
            connection = socket.create_connection(
                (address.host, address.port), self._connect_timeout_s
            )
            self._socket = connection  # closed where the rest fails
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            if self._tls is not None:
                connection = self._tls.wrap_socket(connection, server_hostname=address.host)
        except TimeoutError as error:
            raise unreachable(self._url, timeout_s=self._connect_timeout_s) from error
        self._socket = connection
        return connection

    @cached_property
    def _tls(self) -> ssl.SSLContext | None:
        return self._address.tls()

    def _disconnect(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    @contextmanager
    def _translated_errors(self, timeout_s: float) -> Iterator[None]:
        try:
            yield
        except (OSError, http.client.HTTPException) as error:
            self._disconnect()
            raise translated(error, self._url, timeout_s=timeout_s) from error
        except BaseException:  # a signal handler's too
            self._disconnect()
            raise


def _send_all(connection: socket.socket, head: bytes, body: bytes) -> None:
    """By one call where it can be, so that the service is woken once, and without a copy."""
    if isinstance(connection, ssl.SSLSocket) or not hasattr(connection, "sendmsg"):
        connection.sendall(head + body)
        return
    sent = connection.sendmsg([head, body])
    for part in (head, body):
        if rest := memoryview(part)[sent:]:
            connection.sendall(rest)
        sent = max(0, sent - len(part))
