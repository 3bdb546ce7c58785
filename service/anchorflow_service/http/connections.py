"""What a connection may cost before a request stands on it: how many, how long, how large a head.

uvicorn's own limit on concurrency answers health checks with its plain-text refusal too, and it
waits for a request's bytes for ever. Both are decided here, and refusals are the contract's.
"""

from __future__ import annotations

import asyncio
import json
import math
import uuid
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, auto
from functools import partial
from typing import cast

import httptools
from uvicorn.protocols.http.httptools_impl import (
    STATUS_LINE,
    HttpToolsProtocol,
    RequestResponseCycle,
)

from anchorflow_client.errors import InvalidRequest
from anchorflow_service.http.joined_head import JoinedHead
from anchorflow_service.http.places import ConnectionPlaces, source_of
from anchorflow_service.http.request_id import HEADER
from anchorflow_service.http.second_half import SecondHalf
from anchorflow_service.http.unsent import held, untaken
from anchorflow_service.observability.exchanges import OTHER, REFUSED, Exchange, Listener

RESERVE = 64
"""Connections beyond the limit that are still heard, so that a probe gets through a crowd."""
RESERVED = "is_in_reserve"
"""In a request's state: its connection is one of those."""
SHARE = 0.75
"""Of the connections, for one address."""
MOST_AHEAD = 32
"""Requests that one connection may send before the first is answered."""
MOST_BYTES_AHEAD = 64 * 2**10
"""Of the bodies of those requests."""
NO_REQUEST = "Invalid HTTP request received."
LOOKS = 4
"""At what a client has taken, in the time in which it has to take something."""
SEPARATORS = len(b":\r\n")
"""Bytes of a header beside its name and its value; white space around that is not counted."""
FRAMING = (b"content-length", b"transfer-encoding")
"""Headers that say how long a body is."""


@dataclass(frozen=True)
class ConnectionLimits:
    """Bounds on sockets and on what has come over them."""

    max_connections: int = 512
    """At a time. Where all of them have a request, those on further ones are `overloaded`, health
    excepted; otherwise the one that has waited longest without a request is closed."""
    max_per_address: int | None = None
    """Of those, for one address; None: three quarters."""
    max_head_bytes: int = 16 * 2**10
    """Of a request's target and its headers together."""
    head_s: float = 10.0
    """For a request line and headers to come in; then the connection is closed."""
    receive_s: float = 60.0
    """For the body after them; then the connection is closed."""
    send_s: float = 60.0
    """In which a client has to take something of what is written for it, however little; then the
    connection is closed."""

    def places(self) -> ConnectionPlaces[LimitedConnection]:
        """Empty ones."""
        share = math.ceil(SHARE * self.max_connections)
        most = share if self.max_per_address is None else self.max_per_address
        return ConnectionPlaces(
            places=self.max_connections,
            per_source=most,
            reserve=RESERVE,
            may_close=LimitedConnection.has_sent_all,
        )


class Stage(Enum):
    """What of the latest request has come."""

    HEAD = auto()
    """Less than its head; of a new connection nothing at all."""
    BODY = auto()
    """Its head, and not all of its body."""
    WHOLE = auto()


class LimitedConnection(HttpToolsProtocol):
    """One connection of a server; `limited` makes the class, with the limits and the places."""

    limits: ConnectionLimits
    places: ConnectionPlaces[LimitedConnection]
    listeners: Sequence[Listener]
    """Told of answers that are none of the application's."""
    _stage = Stage.HEAD
    _num_heads = 0
    """That began, the one on its way included."""
    _head_bytes = 0
    """Of the one on its way, in its target and headers."""
    _head_came = 0
    """Of the one on its way, in all that came of it."""
    _is_refused = False
    """Nothing that comes from now on is read."""
    _receiving: asyncio.TimerHandle | None = None
    _receives_body = False
    _sending: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Serve it, or hear it and refuse, by how many there are."""
        super().connection_made(transport)
        self._unanswered: deque[RequestResponseCycle] = deque()
        source = None if self.client is None else source_of(self.client[0])
        has_place, evicted = self.places.enter(self, source)
        if evicted is not None:
            evicted.transport.abort()
        if not has_place:
            self.app_state = {**self.app_state, RESERVED: True}
        self._watch()

    def data_received(self, data: bytes) -> None:
        """Take what came, and wait for the rest no longer than the limit."""
        if self._is_refused:
            return
        before, heads = self._stage, self._num_heads
        self._unset_keepalive_if_required()
        self._feed(data)
        if self._stage is Stage.HEAD:
            self._note_half_a_head(data, before, heads)
        self._watch()

    def on_message_begin(self) -> None:
        """A head begins."""
        super().on_message_begin()
        self._stage, self._head_bytes = Stage.HEAD, 0
        self._num_heads += 1

    def on_url(self, url: bytes) -> None:
        """Part of the target."""
        self._note_head(len(url))
        super().on_url(url)

    def on_header(self, name: bytes, value: bytes) -> None:
        """A header; what comes after a body in chunks, as a trailer, is none."""
        self._note_head(len(name) + len(value) + SEPARATORS)
        if self._stage is Stage.HEAD:
            super().on_header(name, value)

    def on_headers_complete(self) -> None:
        """Begin the request."""
        hosts = sum(name == b"host" for name, _ in self.headers)
        assert self.parser is not None
        if hosts > 1 or (not hosts and self.parser.get_http_version() == "1.1"):
            raise ValueError(f"expected one Host, got {hosts}")
        if len(self.pipeline) >= MOST_AHEAD:
            raise ValueError(f"expected at most {MOST_AHEAD} requests before an answer")
        self._stage = Stage.BODY
        super().on_headers_complete()
        joined = JoinedHead(self.transport)
        self.cycle.transport = cast("asyncio.Transport", joined)
        self.cycle.on_response = partial(self._end_response, joined)
        self._unanswered.append(self.cycle)
        # uvicorn reads no further where an answer is still due, and would not see the caller leave.
        self.flow.resume_reading()

    def on_body(self, body: bytes) -> None:
        """Part of a body, which is kept until the request's turn comes."""
        if self.pipeline:
            ahead = len(body) + sum(len(cycle.body) for cycle, _ in self.pipeline)
            if ahead > MOST_BYTES_AHEAD:
                raise ValueError(f"expected at most {MOST_BYTES_AHEAD} bytes before an answer")
        super().on_body(body)

    def on_message_complete(self) -> None:
        """All of a request is there."""
        self._stage = Stage.WHOLE
        super().on_message_complete()

    def on_response_complete(self) -> None:
        """Wait for the next request, or take it up where it has come already."""
        super().on_response_complete()
        if self._stage is Stage.WHOLE:
            self._stop_watching()  # uvicorn limits the wait for the first byte
        else:
            self._watch()
        self._note_place()
        self._watch_sending()

    def pause_writing(self) -> None:
        """The client is slower than what is written for it."""
        super().pause_writing()
        self._watch_sending()

    def timeout_keep_alive_handler(self) -> None:
        """Close it; where an answer is still on its way, which asyncio would break off over TLS
        30 s later, look again.
        """
        if not held(self.transport):
            super().timeout_keep_alive_handler()
            return
        self.timeout_keep_alive_task = self.loop.call_later(
            self.timeout_keep_alive, self.timeout_keep_alive_handler
        )

    def connection_lost(self, exc: Exception | None) -> None:
        """Give the place back, stop waiting, and tell whoever works on an answer."""
        self.places.leave(self)
        self._stop_watching()
        self._stop_watching_sending()
        self.pipeline.clear()
        for cycle in self._unanswered:  # uvicorn tells the latest alone, which may not have begun
            cycle.disconnected = True
            cycle.message_event.set()
        super().connection_lost(exc)

    def send_400_response(self, msg: str) -> None:
        """The refusal of what is no HTTP, or too long a head, as the contract writes it."""
        self._is_refused = True
        if self._stage is Stage.BODY and self.pipeline:  # its turn will not come
            self.pipeline.popleft()
            self._unanswered.pop()
            self.cycle, self._stage = self._unanswered[-1], Stage.WHOLE
        cycle = self.cycle
        if cycle is not None and not cycle.response_complete:
            if self._stage is not Stage.BODY:
                cycle.keep_alive = False  # what came before it is answered, and no more
                return
            if cycle.response_started:  # no other answer may come between
                self.transport.abort()
                return
        most = self.limits.max_head_bytes
        said = f"{msg} Expected HTTP/1.1 with a head of at most {most} bytes"
        error = InvalidRequest(said, http_status=400)
        body = json.dumps(error.to_dict()).encode()
        head = (
            f"content-type: application/json\r\ncontent-length: {len(body)}\r\n"
            f"{HEADER}: {self._note_refusal(error.http_status)}\r\nconnection: close\r\n\r\n"
        )
        self.transport.write(STATUS_LINE[error.http_status] + head.encode() + body)
        self.transport.close()
        self._watch_sending()

    def has_sent_all(self) -> bool:
        """Whether the client has what was written for it, as far as can be told from here."""
        return not held(self.transport)

    def _feed(self, data: bytes) -> None:
        assert self.parser is not None
        try:
            self.parser.feed_data(data)
        except httptools.HttpParserUpgrade as upgrade:
            self._go_on(data[upgrade.args[0] :])
        except httptools.HttpParserError:
            self.send_400_response(NO_REQUEST)

    def _go_on(self, data: bytes) -> None:
        """With a request that would rather be of another protocol, and is answered in this one.

        The parser has left its body and all that follows to that protocol.
        """
        framing = [each for each in self.headers if each[0] in FRAMING]
        if framing:
            self._stage, self.cycle.more_body = Stage.BODY, True
            self.cycle.message_event.clear()
            head = b"".join(b"%b: %b\r\n" % each for each in framing)
            data = b"POST / HTTP/1.1\r\n%b\r\n%b" % (head, data)
        self.parser = httptools.HttpRequestParser(SecondHalf(self) if framing else self)
        self._feed(data)

    def _end_response(self, joined: JoinedHead) -> None:
        joined.flush()
        self._unanswered.popleft()
        self.on_response_complete()

    def _note_head(self, size: int) -> None:
        self._head_bytes += size
        if self._head_bytes > self.limits.max_head_bytes:
            raise ValueError("head too long")  # it is refused as what is no HTTP

    def _note_half_a_head(self, data: bytes, before: Stage, heads: int) -> None:
        """A header is counted once it is there; one that goes on and on is refused before."""
        if self._num_heads == heads:
            self._head_came += len(data)
        else:  # unless something else came with it, all of this is its beginning
            is_alone = self._num_heads == heads + 1 and (before is Stage.WHOLE or not heads)
            self._head_came = len(data) if is_alone else 0
        if self._head_came > self.limits.max_head_bytes and not self._is_refused:
            self.send_400_response(NO_REQUEST)

    def _watch(self) -> None:
        """Limit the time while a head or a body is still coming in."""
        self._note_place()
        receives_body = self._stage is Stage.BODY
        is_answering = self.cycle is not None and not self.cycle.response_complete
        if self._stage is Stage.WHOLE or (is_answering and not receives_body):
            self._stop_watching()
            return
        if self._receiving is not None and receives_body == self._receives_body:
            return
        self._stop_watching()
        limit_s = self.limits.receive_s if receives_body else self.limits.head_s
        self._receives_body = receives_body
        self._receiving = self.loop.call_later(limit_s, self.transport.abort)

    def _stop_watching(self) -> None:
        if self._receiving is not None:
            self._receiving.cancel()
            self._receiving = None

    def _watch_sending(self) -> None:
        """Limit the time in which the client takes nothing of what is written for it."""
        self._stop_watching_sending()
        self._look_at_sending(math.inf, self.loop.time())

    def _look_at_sending(self, before: float, since: float) -> None:
        """before: bytes that it still had to take at the time `since` [s]"""
        self._sending = None
        if not held(self.transport):
            return
        now, left = self.loop.time(), untaken(self.transport)
        if left < before:
            before, since = left, now
        elif now - since >= self.limits.send_s:
            self.transport.abort()
            return
        self._sending = self.loop.call_later(
            self.limits.send_s / LOOKS, self._look_at_sending, before, since
        )

    def _stop_watching_sending(self) -> None:
        if self._sending is not None:
            self._sending.cancel()
            self._sending = None

    def _note_refusal(self, status: int) -> str:
        """Have it counted once; the request's id, of its own where the application has none."""
        if self.cycle is not None and not self.cycle.response_complete:
            state = self.cycle.scope.get("state", {})
            state[REFUSED] = status  # the application is at work on it, and will be counted
            return state.get("request_id") or uuid.uuid4().hex
        request_id = uuid.uuid4().hex
        for listener in self.listeners:
            listener(Exchange("-", "-", OTHER, status, 0.0, request_id, None))
        return request_id

    def _note_place(self) -> None:
        """Whether it has a request is what its place depends on."""
        if self.cycle is None or self.cycle.response_complete:
            self.places.begin_waiting(self)
        else:
            self.places.begin_request(self)


def limited(
    limits: ConnectionLimits, listeners: Sequence[Listener] = ()
) -> type[LimitedConnection]:
    """The protocol of one server for `uvicorn.Config(http=…)`, within these limits.

    listeners: told of what is refused before it is a request
    """
    attributes = {"limits": limits, "places": limits.places(), "listeners": listeners}
    return type("LimitedConnection", (LimitedConnection,), attributes)
