"""Transports move HTTP's bytes: the interfaces, the service's address, and one blocking socket."""

from __future__ import annotations

import http.client
import os
import re
import socket
import ssl
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol
from urllib.parse import urlsplit

from anchorflow_client.errors import (
    ConnectionFailed,
    InvalidAnswer,
    TimedOut,
    TransportError,
    UsageError,
)
from anchorflow_client.http.answer_parser import AnswerParser, HttpAnswer

PORTS = {"http": http.client.HTTP_PORT, "https": http.client.HTTPS_PORT}
"""Default ports of the supported URL schemes."""
RECEIVE_BYTES = 256 * 2**10
"""Size of the receive buffer."""
CLOSED_BY_PEER = (ConnectionError, ssl.SSLEOFError, ssl.SSLZeroReturnError)
"""Errors on a connection that the service has closed."""
EXPECTED_URL = "expected http://host[:port] or https://host[:port], got"


class Transport(Protocol):
    """Sends one HTTP request at a time."""

    def send(
        self,
        method: str,
        path: str,
        headers: Mapping[str, str],
        body: bytes | None,
        timeout_s: float,
    ) -> HttpAnswer:
        """Return the answer, whatever its status. Raises `TransportError` if there is none."""
        ...

    def close(self) -> None:
        """Close the connection."""


class AsyncTransport(Protocol):
    """Sends HTTP requests, several at the same time."""

    async def send(
        self,
        method: str,
        path: str,
        headers: Mapping[str, str],
        body: bytes | None,
        timeout_s: float,
    ) -> HttpAnswer:
        """Return the answer, whatever its status. Raises `TransportError` if there is none."""
        ...

    async def aclose(self) -> None:
        """Close the connections."""


@dataclass(frozen=True)
class Address:
    """The address of a service."""

    host: str
    port: int
    authority: str
    """Host and port for the Host header."""
    is_secure: bool

    @classmethod
    def of(cls, url: str) -> Address:
        """Parse a service's http:// or https:// URL. Raises `UsageError`."""
        if "@" in re.split(r"[/?#]", f"{url}".partition("//")[2] or f"{url}")[0]:
            raise UsageError(  # without the URL, which may hold a password
                f"{EXPECTED_URL} one with a user before the host; a bearer token is given as "
                "token=…"
            )
        try:
            parts = urlsplit(url)
            port = parts.port
        except ValueError as error:
            raise UsageError(f"{EXPECTED_URL} {url!r}: {error}") from error
        if parts.scheme not in PORTS or not parts.hostname:
            raise UsageError(f"{EXPECTED_URL} {url!r}")
        if not (parts.path.isascii() and parts.path.isprintable()) or " " in parts.path:
            raise UsageError(f"expected a path of printable ASCII without spaces, got {url!r}")
        try:
            parts.hostname.encode("idna")
        except UnicodeError as error:
            raise UsageError(
                f"expected a host in http://host[:port], got {url!r}: {error}"
            ) from error
        if port == 0:
            raise UsageError(f"expected a port from 1 to 65535, got {url!r}")
        authority = parts.netloc if parts.netloc.isascii() else parts.netloc.encode("idna").decode()
        return cls(parts.hostname, port or PORTS[parts.scheme], authority, parts.scheme == "https")

    @cached_property
    def tls(self) -> ssl.SSLContext | None:
        """Return a context with the system's authorities for HTTP/1.1; None for plain HTTP."""
        if not self.is_secure:
            return None
        context = ssl.create_default_context()
        context.set_alpn_protocols(["http/1.1"])
        return context

    def head(self, method: str, path: str, headers: Mapping[str, str], body: bytes | None) -> bytes:
        """Return a request's head. Raises `UsageError` without a value, which may be a token."""
        lines = [f"{method} {path} HTTP/1.1"]
        all_headers = {"Host": self.authority, "Accept-Encoding": "identity", **headers}
        if body is not None:
            all_headers["Content-Length"] = str(len(body))
        for name, value in all_headers.items():
            if not (value.isascii() and value.isprintable()):
                raise UsageError(f"{name}: expected printable ASCII, got other characters too")
            lines.append(f"{name}: {value}")
        return "\r\n".join([*lines, "", ""]).encode()


def translated(error: Exception, url: str, *, timeout_s: float) -> TransportError:
    """Translate an `OSError` or `HTTPException` of an open connection into the contract's error.

    timeout_s: the longest wait for the service's next bytes, for the message
    """
    match error:
        case TimeoutError():
            return TimedOut(f"{url} did not answer within {timeout_s:g} s")
        case OSError() | http.client.IncompleteRead():
            return ConnectionFailed(f"{url}: {error}")
        case _:
            return InvalidAnswer(f"{url} does not speak HTTP: {error!r}")


def unreachable(url: str, *, timeout_s: float) -> TimedOut:
    """Return the error for a connection that could not be opened in time."""
    return TimedOut(f"{url} could not be reached within {timeout_s:g} s")


class SocketTransport:
    """One kept-alive connection, reopened once if the service had closed it while it was idle.

    Threads may share it, and take turns. After a fork each process has a connection of its own.
    """

    def __init__(self, url: str, *, connect_timeout_s: float) -> None:
        """Parse the URL; the first `send` connects. Raises `UsageError` if the URL is invalid."""
        self._url = url
        self._address = Address.of(url)
        self._connect_timeout_s = float(connect_timeout_s)
        self._locks: dict[int, threading.Lock] = {}
        self._socket: socket.socket | None = None
        self._pid = os.getpid()
        # Reused: the system would allocate and free a buffer of this size for every answer.
        self._received = memoryview(bytearray(RECEIVE_BYTES))

    def send(
        self,
        method: str,
        path: str,
        headers: Mapping[str, str],
        body: bytes | None,
        timeout_s: float,
    ) -> HttpAnswer:
        """Send a request and return its answer; `timeout_s` bounds each wait for more bytes."""
        head = self._address.head(method, path, headers, body)
        with self._turn(), self._translated_errors(timeout_s):
            if self._socket is not None:
                try:
                    return self._exchange(self._socket, head, body, timeout_s)
                except CLOSED_BY_PEER:  # while it was idle
                    self._disconnect()
            return self._exchange(self._connect(), head, body, timeout_s)

    def close(self) -> None:
        """Close the connection; a later `send` opens it again."""
        with self._turn():
            self._disconnect()

    @contextmanager
    def _turn(self) -> Iterator[None]:
        """Lock the connection for one thread, and drop it if another process opened it."""
        pid = os.getpid()
        # A lock for each process: one that another thread held at a fork stays locked in the child.
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
        with suppress(*CLOSED_BY_PEER):
            _send_all(connection, head, body or b"")
        parser = AnswerParser()
        while parser.answer is None:
            if size := connection.recv_into(self._received):
                parser.feed(self._received[:size])
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
            self._socket = connection  # so that it is closed if the rest fails
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            if address.tls is not None:
                connection = address.tls.wrap_socket(connection, server_hostname=address.host)
        except TimeoutError as error:
            raise unreachable(self._url, timeout_s=self._connect_timeout_s) from error
        self._socket = connection
        return connection

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
    """Send both with one system call if possible, which wakes the service once, without a copy."""
    if isinstance(connection, ssl.SSLSocket) or not hasattr(connection, "sendmsg"):
        connection.sendall(head + body)
        return
    sent = connection.sendmsg([head, body])
    for part in (head, body):
        if rest := memoryview(part)[sent:]:
            connection.sendall(rest)
        sent = max(0, sent - len(part))
