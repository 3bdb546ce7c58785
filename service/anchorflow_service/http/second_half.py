"""A body whose head another parser has read: what uvicorn is told of it."""

from __future__ import annotations

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol


class SecondHalf:
    """What a parser tells of a body whose head was told by another, and of all that follows it."""

    def __init__(self, connection: HttpToolsProtocol) -> None:
        self._connection = connection
        self._is_known = True
        """The head."""

    def on_message_begin(self) -> None:
        """Of the next request."""
        if not self._is_known:
            self._connection.on_message_begin()

    def on_url(self, url: bytes) -> None:
        """Of the next request."""
        if not self._is_known:
            self._connection.on_url(url)

    def on_header(self, name: bytes, value: bytes) -> None:
        """Of the next request, or a trailer."""
        if not self._is_known:
            self._connection.on_header(name, value)

    def on_headers_complete(self) -> None:
        """Of the next request."""
        if not self._is_known:
            self._connection.on_headers_complete()

    def on_body(self, body: bytes) -> None:
        """Of any request."""
        self._connection.on_body(body)

    def on_message_complete(self) -> None:
        """Of any request."""
        self._is_known = False
        self._connection.on_message_complete()
