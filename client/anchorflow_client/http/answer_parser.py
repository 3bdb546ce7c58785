"""Parse one HTTP/1 answer from bytes as they arrive (RFC 9112). Does no I/O.

`http.client` would parse heads as e-mail, which takes longer than the rest of a client's work.
"""

from __future__ import annotations

import http.client
import re
from collections.abc import Generator, Mapping, Sequence
from typing import NamedTuple, TypeVar

HttpAnswer = tuple[int, Mapping[str, str], bytes]
"""Status, headers with their names in lower case, body."""
Part = TypeVar("Part")
Parsing = Generator[None, None, Part]
"""A parser that yields when it needs more bytes, and is resumed when they arrived or ended."""

MAX_LINE = 65536
MAX_HEAD_LINES = 256
MAX_DIGITS = 18  # which fit 64 bits
BLANK = (b"\r\n", b"\n")
STATUS_LINE = re.compile(rb"HTTP/1\.(\d) ([1-9]\d\d)(?: |\r?\n)")
NO_BODY = (204, 304)


class _Head(NamedTuple):
    """The head of an answer.

    length: bytes of the body; None: it is chunked, or ends with the connection
    """

    status: int
    headers: Mapping[str, str]
    is_chunked: bool
    length: int | None
    keeps_alive: bool


class AnswerParser:
    """Parses one answer. Its errors are those of `http.client`."""

    def __init__(self) -> None:
        self.answer: HttpAnswer | None = None
        """The answer, as soon as it is complete."""
        self.keeps_alive = False
        """Whether the connection may carry another request after it."""
        self._has_begun = False
        self._buffer = bytearray()
        self._has_ended = False
        self._parsing = self._parse()
        next(self._parsing)

    def feed(self, data: bytes | memoryview) -> None:
        """Parse the next bytes. Raises `HTTPException` if they are not HTTP."""
        self._buffer += data
        self._has_begun, self.keeps_alive = True, False
        self._resume()

    def end(self) -> None:
        """Note that the connection has ended. Raises `RemoteDisconnected` or `HTTPException`."""
        self._has_ended = True
        self._resume()

    def _resume(self) -> None:
        if self.answer is None:
            next(self._parsing, None)

    def _parse(self) -> Parsing[None]:
        yield
        head = yield from self._head()
        while head.status < 200:  # such as 100 Continue: the final answer follows
            head = yield from self._head()
        body = yield from self._body(head)
        self.keeps_alive = head.keeps_alive and not self._buffer
        self.answer = head.status, head.headers, body

    def _head(self) -> Parsing[_Head]:
        lines = [(yield from self._line())]
        if not lines[0].startswith(b"HTTP/"):
            raise http.client.BadStatusLine(repr(lines[0]))
        while lines[-1] not in BLANK:
            if len(lines) > MAX_HEAD_LINES:
                raise http.client.HTTPException(f"a head of more than {MAX_HEAD_LINES} lines")
            lines.append((yield from self._line()))
        return _parse_head(lines)

    def _body(self, head: _Head) -> Parsing[bytes]:
        if head.is_chunked:
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
        with memoryview(self._buffer) as buffer:  # slicing the bytearray would copy twice
            taken = bytes(buffer[:size])
        del self._buffer[:size]
        return taken


def whole_number(header: str | None) -> int | None:
    """Parse a whole number in a header; None for none, or a date as in Retry-After."""
    return int(header) if header and header.isdecimal() and len(header) <= MAX_DIGITS else None


def _parse_head(lines: Sequence[bytes]) -> _Head:
    """Parse a head's lines, the blank one included. Raises `HTTPException`."""
    begin = STATUS_LINE.match(lines[0])
    if begin is None:
        raise http.client.BadStatusLine(repr(lines[0]))
    status = int(begin[2])
    headers = _parse_headers(lines[1:-1])
    is_chunked = headers.get("transfer-encoding", "").lower() == "chunked"
    length = 0 if status < 200 or status in NO_BODY else _content_length(headers)
    has_end = is_chunked or length is not None
    closes = begin[1] == b"0" or "close" in headers.get("connection", "").lower()
    return _Head(status, headers, is_chunked, length, has_end and not closes)


def _parse_headers(lines: Sequence[bytes]) -> dict[str, str]:
    """Return headers by their names in lower case; repeated ones are joined by commas."""
    headers: dict[str, str] = {}
    name = ""
    for line in lines:
        text = line.decode("latin-1")
        if text[0] in " \t" and name:  # a folded line continues the previous header
            headers[name] += f" {text.strip()}"
            continue
        name, colon, value = text.partition(":")
        name, value = name.lower(), value.strip()
        if not colon or not name or name != name.strip():
            raise http.client.HTTPException(f"expected a header, got {line!r}")
        headers[name] = f"{headers[name]}, {value}" if name in headers else value
    return headers


def _content_length(headers: Mapping[str, str]) -> int | None:
    value = headers.get("content-length")
    length = whole_number(value)
    if value is not None and length is None:
        raise http.client.HTTPException(f"expected a body's length, got {value!r}")
    return length


def _chunk_size(line: bytes) -> int:
    digits = line.partition(b";")[0].strip()
    try:
        if digits.isalnum():  # int() would accept a sign, or an underscore
            return int(digits, 16)
    except ValueError:
        pass
    raise http.client.HTTPException(f"expected a chunk's size, got {line!r}")
