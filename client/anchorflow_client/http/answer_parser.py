"""One HTTP answer, out of bytes as they come. Knows no socket.

Its head is read by `http.client`, so that both clients take the same answers for HTTP.
"""

from __future__ import annotations

import http.client
import io
import re
from collections.abc import Generator
from socket import socket
from typing import TypeVar, cast

from anchorflow_client.http.transport import HttpAnswer

Part = TypeVar("Part")
Parsing = Generator[None, None, Part]
"""Goes on when there are more bytes, or none will come."""

MAX_LINE = 65536
MAX_HEAD_LINES = 256
BLANK = (b"\r\n", b"\n")
INTERIM = re.compile(rb"HTTP/1\.\d 1\d\d\b")


class AnswerParser:
    """Used once. Its errors are those of `http.client`."""

    def __init__(self) -> None:
        self.answer: HttpAnswer | None = None
        """The answer, once it is complete."""
        self.keeps_alive = False
        """Whether the connection may carry another request after it."""
        self._has_begun = False
        self._buffer = bytearray()
        self._has_ended = False
        self._parsing = self._parse()
        next(self._parsing)

    def feed(self, data: bytes) -> None:
        """The next bytes.

        Raises:
            HTTPException: they are not HTTP's.
        """
        self._buffer += data
        self._has_begun, self.keeps_alive = True, False
        self._go_on()

    def end(self) -> None:
        """No more bytes will come.

        Raises:
            RemoteDisconnected: none came.
            HTTPException: the answer breaks off.
        """
        self._has_ended = True
        self._go_on()

    def _go_on(self) -> None:
        if self.answer is None:
            next(self._parsing, None)

    def _parse(self) -> Parsing[None]:
        yield
        head = yield from self._head()
        body = yield from self._body(head)
        self.keeps_alive = not head.will_close and not self._buffer
        self.answer = head.status, {k.lower(): v for k, v in head.getheaders()}, body

    def _head(self) -> Parsing[http.client.HTTPResponse]:
        lines = [(yield from self._line())]
        if not lines[0].startswith(b"HTTP/"):
            raise http.client.BadStatusLine(repr(lines[0]))
        while lines[-1] not in BLANK:
            if len(lines) > MAX_HEAD_LINES:
                raise http.client.HTTPException(f"a head of more than {MAX_HEAD_LINES} lines")
            lines.append((yield from self._line()))
        if INTERIM.match(lines[0]):  # such as 100 Continue: the answer proper is still to come
            return (yield from self._head())
        response = http.client.HTTPResponse(cast("socket", _Read(b"".join(lines))))
        response.begin()
        return response

    def _body(self, head: http.client.HTTPResponse) -> Parsing[bytes]:
        if head.chunked:
            return (yield from self._chunks())
        if head.length is not None:
            return (yield from self._exactly(head.length))
        while not self._has_ended:
            yield
        return self._take(len(self._buffer))

    def _chunks(self) -> Parsing[bytes]:
        body = bytearray()
        while size := _chunk_size((yield from self._line())):
            body += yield from self._exactly(size)
            yield from self._line()
        while (yield from self._line()) not in BLANK:
            pass  # trailers
        return bytes(body)

    def _line(self) -> Parsing[bytes]:
        while (end := self._buffer.find(b"\n")) < 0:
            if len(self._buffer) > MAX_LINE:
                raise http.client.LineTooLong("line")
            yield from self._more()
        return self._take(end + 1)

    def _exactly(self, size: int) -> Parsing[bytes]:
        while (missing := size - len(self._buffer)) > 0:
            yield from self._more(missing)
        return self._take(size)

    def _more(self, missing: int | None = None) -> Parsing[None]:
        if not self._has_ended:
            yield
        elif self._has_begun:
            raise http.client.IncompleteRead(bytes(self._buffer), missing)
        else:
            raise http.client.RemoteDisconnected("the connection was closed without an answer")

    def _take(self, size: int) -> bytes:
        taken = bytes(self._buffer[:size])
        del self._buffer[:size]
        return taken


def _chunk_size(line: bytes) -> int:
    digits = line.partition(b";")[0].strip()
    if not digits.isalnum():  # int() would take a sign, or an underscore
        raise http.client.HTTPException(f"expected a chunk's size, got {line!r}")
    try:
        return int(digits, 16)
    except ValueError as error:
        raise http.client.HTTPException(f"expected a chunk's size, got {line!r}") from error


class _Read:
    """Bytes in place of the socket from which they came."""

    def __init__(self, data: bytes) -> None:
        self._data = data

    def makefile(self, _mode: str) -> io.BytesIO:
        """The one thing that `HTTPResponse` asks of a socket."""
        return io.BytesIO(self._data)
