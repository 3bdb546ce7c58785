"""What carries HTTP: a socket, or whatever a test puts in its place."""

from __future__ import annotations

import http.client
from collections.abc import Mapping
from typing import Protocol
from urllib.parse import SplitResult, urlsplit

from anchorflow_client.errors import ConnectionFailed, InvalidAnswer, TimedOut, TransportError

HttpAnswer = tuple[int, Mapping[str, str], bytes]
"""Status, headers with their names in lower case, body."""

SCHEMES = ("http", "https")


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


def address_of(url: str) -> SplitResult:
    """The parts of a service's URL.

    Raises:
        ValueError: `url` is not http://host[:port] or https://host[:port].
    """
    parts = urlsplit(url)
    if parts.scheme not in SCHEMES or not parts.hostname:
        raise ValueError(f"expected http://host[:port] or https://host[:port], got {url!r}")
    return parts


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
