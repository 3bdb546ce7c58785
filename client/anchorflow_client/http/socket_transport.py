"""HTTP over one socket that is kept open."""

from __future__ import annotations

import http.client
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

from anchorflow_client.http.transport import HttpAnswer, address_of, translated, unreachable

JOINED_BYTES = 512 * 2**10
"""Of a body: to copy so many behind the head takes less than to send them by a second call."""


class SocketTransport:
    """One connection, kept alive; opened again once where the service had closed an idle one.

    Threads may share it, and take turns.
    """

    def __init__(self, url: str, *, connect_timeout_s: float) -> None:
        """Opens nothing yet.

        Raises:
            ValueError: `url` is not http://host[:port] or https://host[:port].
        """
        parts = address_of(url)
        assert parts.hostname is not None
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
            connection.send_at_once(method, path, body, headers)
        answer = connection.getresponse()
        names = {name.lower(): value for name, value in answer.getheaders()}
        return answer.status, names, answer.read()

    @contextmanager
    def _translated_errors(self, timeout_s: float) -> Iterator[None]:
        try:
            yield
        except (OSError, http.client.HTTPException) as error:
            connection = self._connection
            if isinstance(error, TimeoutError) and connection.sock is None:
                assert connection.timeout is not None
                raise unreachable(self._url, timeout_s=connection.timeout) from error
            connection.close()
            raise translated(error, self._url, timeout_s=timeout_s) from error
        except BaseException:  # a signal handler's too
            self._connection.close()
            raise


class _AtOnce(http.client.HTTPConnection):
    """Sends a head together with its body, so that the service is woken once."""

    _parts: list[bytes] | None = None

    def send_at_once(
        self, method: str, path: str, body: bytes | None, headers: Mapping[str, str]
    ) -> None:
        """As `request`, on a connection that is open."""
        if body is None or len(body) > JOINED_BYTES:
            self.request(method, path, body, dict(headers))
            return
        self._parts = parts = []
        try:
            self.request(method, path, body, dict(headers))
        finally:
            self._parts = None
        self.send(b"".join(parts))

    def send(self, data: Any) -> None:
        if self._parts is None:
            super().send(data)
        else:
            self._parts.append(data)


class _SecureAtOnce(_AtOnce, http.client.HTTPSConnection):
    """The same through TLS."""


_CONNECTIONS = {"http": _AtOnce, "https": _SecureAtOnce}
