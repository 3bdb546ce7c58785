"""The transport: HTTP over a socket, or whatever a test puts in its place."""

from __future__ import annotations

import http.client
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Protocol
from urllib.parse import urlsplit

from anchorflow_client.errors import ConnectionFailed, InvalidAnswer, TimedOut, TransportError

HttpAnswer = tuple[int, Mapping[str, str], bytes]
"""Status, headers with their names in lower case, body."""


class Transport(Protocol):
    """Carries one HTTP request at a time."""

    def send(
        self,
        method: str,
        path: str,
        headers: Mapping[str, str],
        body: bytes | None,
        timeout_s: float,
    ) -> HttpAnswer:
        """The answer of whatever status. Raises `TransportError` where there is none."""
        ...

    def close(self) -> None:
        """Let go of what it holds."""
        ...


class SocketTransport:
    """One connection, kept alive; opened again once where the service had closed an idle one.

    Threads may share it, and take turns.
    """

    def __init__(self, url: str, *, connect_timeout_s: float) -> None:
        """Opens nothing yet.

        Raises:
            ValueError: `url` is not http://host[:port] or https://host[:port].
        """
        parts = urlsplit(url)
        if parts.scheme not in _CONNECTIONS or not parts.hostname:
            raise ValueError(f"expected http://host[:port] or https://host[:port], got {url!r}")
        self._url = url
        self._lock = threading.Lock()
        connection = _CONNECTIONS[parts.scheme]
        self._connection = connection(parts.hostname, parts.port, timeout=connect_timeout_s)

    def send(
        self,
        method: str,
        path: str,
        headers: Mapping[str, str],
        body: bytes | None,
        timeout_s: float,
    ) -> HttpAnswer:
        """Send and wait; `timeout_s` bounds each wait for the service's next bytes."""
        with self._lock, self._translated_errors(timeout_s):
            if self._connection.sock is not None:
                try:
                    return self._exchange(method, path, headers, body, timeout_s)
                except ConnectionError:  # The service closed it while it was idle.
                    self._connection.close()
            return self._exchange(method, path, headers, body, timeout_s)

    def close(self) -> None:
        """Close the connection; a later `send` opens it again."""
        with self._lock:
            self._connection.close()

    def _exchange(
        self,
        method: str,
        path: str,
        headers: Mapping[str, str],
        body: bytes | None,
        timeout_s: float,
    ) -> HttpAnswer:
        connection = self._connection
        if connection.sock is None:
            connection.connect()
        assert connection.sock is not None
        connection.sock.settimeout(timeout_s)
        # A service that refuses a large body stops reading it: its answer may be here already.
        with suppress(BrokenPipeError, ConnectionResetError):
            connection.request(method, path, body, dict(headers))
        answer = connection.getresponse()
        names = {name.lower(): value for name, value in answer.getheaders()}
        return answer.status, names, answer.read()

    @contextmanager
    def _translated_errors(self, timeout_s: float) -> Iterator[None]:
        try:
            yield
        except (OSError, http.client.HTTPException) as error:
            translated = self._translated(error, timeout_s)
            self._connection.close()
            raise translated from error

    def _translated(self, error: Exception, timeout_s: float) -> TransportError:
        match error:
            case TimeoutError() if self._connection.sock is None:
                waited_s = self._connection.timeout
                return TimedOut(f"{self._url} could not be reached within {waited_s:g} s")
            case TimeoutError():
                return TimedOut(f"{self._url} did not answer within {timeout_s:g} s")
            case OSError() | http.client.IncompleteRead():
                return ConnectionFailed(f"{self._url}: {error}")
            case _:
                return InvalidAnswer(f"{self._url} does not speak HTTP: {error!r}")


_CONNECTIONS = {"http": http.client.HTTPConnection, "https": http.client.HTTPSConnection}
