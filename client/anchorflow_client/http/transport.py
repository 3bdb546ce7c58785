"""What carries HTTP: a socket, or whatever a test puts in its place."""

from __future__ import annotations

import http.client
import re
import ssl
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol
from urllib.parse import urlsplit

from anchorflow_client.errors import ConnectionFailed, InvalidAnswer, TimedOut, TransportError

HttpAnswer = tuple[int, Mapping[str, str], bytes]
"""Status, headers with their names in lower case, body."""

PORTS = {"http": http.client.HTTP_PORT, "https": http.client.HTTPS_PORT}
"""By the schemes of URLs that are known."""


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


class AsyncTransport(Protocol):
    """Carries HTTP requests, several at the same time."""

    async def send(
        self,
        method: str,
        path: str,
        headers: Mapping[str, str],
        body: bytes | None,
        timeout_s: float,
    ) -> HttpAnswer:
        """The answer of whatever status. Raises `TransportError` where there is none."""
        ...

    async def aclose(self) -> None:
        """Let go of what it holds."""
        ...


@dataclass(frozen=True)
class Address:
    """Where a service listens."""

    host: str
    port: int
    authority: str
    """Host and port as a request names them."""
    is_secure: bool

    @classmethod
    def of(cls, url: str) -> Address:
        """The address in a service's URL.

        Raises:
            ValueError: `url` is not http://host[:port] or https://host[:port], its host is no name
                of one, its port is 0, a user stands before it, or a path follows that no request
                could carry.
        """
        if "@" in re.split(r"[/?#]", f"{url}".partition("//")[2] or f"{url}")[0]:
            raise ValueError(  # without the URL, which may hold a password
                "expected http://host[:port] or https://host[:port], got one with a user before "
                "the host; a bearer token is given as token=…"
            )
        try:
            parts = urlsplit(url)
            port = parts.port
        except ValueError as error:
            raise ValueError(
                f"expected http://host[:port] or https://host[:port], got {url!r}: {error}"
            ) from error
        if parts.scheme not in PORTS or not parts.hostname:
            raise ValueError(f"expected http://host[:port] or https://host[:port], got {url!r}")
        if not (parts.path.isascii() and parts.path.isprintable()) or " " in parts.path:
            raise ValueError(f"expected a path of printable ASCII without spaces, got {url!r}")
        try:
            parts.hostname.encode("idna")
        except UnicodeError as error:
            raise ValueError(
                f"expected a host in http://host[:port], got {url!r}: {error}"
            ) from error
        if port == 0:
            raise ValueError(f"expected a port from 1 to 65535, got {url!r}")
        named = parts.netloc if parts.netloc.isascii() else parts.netloc.encode("idna").decode()
        return cls(parts.hostname, port or PORTS[parts.scheme], named, parts.scheme == "https")

    def tls(self) -> ssl.SSLContext | None:
        """What a connection is secured with, if it is: the system's authorities, HTTP/1.1."""
        if not self.is_secure:
            return None
        context = ssl.create_default_context()
        context.set_alpn_protocols(["http/1.1"])
        return context

    def head(self, method: str, path: str, headers: Mapping[str, str], body: bytes | None) -> bytes:
        """The head of a request.

        Raises:
            ValueError: a header is not printable ASCII; what it is, which may be a token, is not
                repeated.
        """
        told = {"Host": self.authority, "Accept-Encoding": "identity", **headers}
        if body is not None:
            told["Content-Length"] = str(len(body))
        lines = [f"{method} {path} HTTP/1.1"]
        for name, value in told.items():
            if not (value.isascii() and value.isprintable()):
                raise ValueError(f"{name}: expected printable ASCII, got other characters too")
            lines.append(f"{name}: {value}")
        return "\r\n".join([*lines, "", ""]).encode()


def translated(error: Exception, url: str, *, timeout_s: float) -> TransportError:
    """What went wrong on an open connection, in the contract's words.

    Args:
        error: an `OSError` or an `http.client.HTTPException`.
        url: of the service.
        timeout_s: how long its next bytes were waited for.
    """
    match error:
        case TimeoutError():
            return TimedOut(f"{url} did not answer within {timeout_s:g} s")
        case OSError() | http.client.IncompleteRead():
            return ConnectionFailed(f"{url}: {error}")
        case _:
            return InvalidAnswer(f"{url} does not speak HTTP: {error!r}")


def unreachable(url: str, *, timeout_s: float) -> TimedOut:
    """No connection came about in that time."""
    return TimedOut(f"{url} could not be reached within {timeout_s:g} s")
