"""What a connection may cost before a request stands on it: how many, how long, how large a head.

uvicorn's own limit on concurrency answers health checks with its plain-text refusal too, and it
waits for a request's bytes for ever. Both are decided here, and refusals are the contract's.
"""

from __future__ import annotations

import asyncio
import json
import math
import re
from dataclasses import dataclass

import h11
from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from anchorflow_client.errors import InvalidRequest, Overloaded
from anchorflow_service.http.body import discard_body
from anchorflow_service.http.errors import error_answer
from anchorflow_service.http.guard import HEALTH
from anchorflow_service.http.places import ConnectionPlaces, source_of

RESERVE = 64
"""Connections beyond the limit that are still heard, so that a probe gets through a crowd."""
SHARE = 0.75
"""Of the connections, for one address."""
BLANK_LINE = re.compile(rb"\n\r?\n")
"""It ends a head."""


@dataclass(frozen=True)
class ConnectionLimits:
    """Bounds on sockets and on what has come over them."""

    max_connections: int = 512
    """At a time. Where all of them have a request, those on further ones are `overloaded`, health
    excepted; otherwise the one that has waited longest without a request is closed."""
    max_per_address: int | None = None
    """Of those, for one address; None: three quarters."""
    max_head_bytes: int = 16 * 2**10
    """Of a request line and its headers together."""
    head_s: float = 10.0
    """For a request line and headers to come in; then the connection is closed."""
    receive_s: float = 60.0
    """For the body after them; then the connection is closed."""

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


class LimitedHead(h11.Connection):
    """Refuses too long a head also where it comes in one piece, which h11 itself lets pass.

    The head of an answer leaves together with what follows it: one call of the system less here,
    and a client is woken once.
    """

    def __init__(self, max_head_bytes: int) -> None:
        super().__init__(h11.SERVER, max_head_bytes)
        self._max_head_bytes = max_head_bytes
        self._answer_head: list[bytes] = []

    def send_with_data_passthrough(self, event: h11.Event) -> list[bytes] | None:
        """What `send` joins and gives to be written; nothing yet for the head of an answer."""
        parts = super().send_with_data_passthrough(event)
        if isinstance(event, h11.Response):
            self._answer_head = parts or []
            return []
        head, self._answer_head = self._answer_head, []
        return None if parts is None else [*head, *parts]

    def next_event(self) -> h11.Event | type[h11.NEED_DATA] | type[h11.PAUSED]:
        """Raises `h11.RemoteProtocolError` for what is no HTTP and for too long a head."""
        if self.their_state is h11.IDLE:
            came, _ = self.trailing_data
            most = self._max_head_bytes
            if len(came) > most and not BLANK_LINE.search(came, 0, most):
                raise h11.RemoteProtocolError("head too long", error_status_hint=431)
        return super().next_event()


class LimitedConnection(H11Protocol):
    """One connection of a server; `limited` makes the class, with the limits and the places."""

    limits: ConnectionLimits
    places: ConnectionPlaces[LimitedConnection]
    _receiving: asyncio.TimerHandle | None = None
    _receives_body = False

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Serve it, or hear it and refuse, by how many there are."""
        super().connection_made(transport)
        self.conn = LimitedHead(self.limits.max_head_bytes)
        source = None if self.client is None else source_of(self.client[0])
        has_place, evicted = self.places.enter(self, source)
        if evicted is not None:
            evicted.transport.abort()
        if not has_place:
            self.app = health_alone(self.app)  # type: ignore[assignment]
        self._watch()

    def data_received(self, data: bytes) -> None:
        """Take what came, and wait for the rest no longer than the limit."""
        super().data_received(data)
        self._watch()

    def on_response_complete(self) -> None:
        """Wait for the next request, or take it up where it has come already."""
        super().on_response_complete()
        if self.conn.their_state is h11.IDLE:
            self._stop_watching()  # uvicorn limits the wait for the first byte
        else:
            self._watch()
        self._note_place()

    def connection_lost(self, exc: Exception | None) -> None:
        """Give the place back and stop waiting."""
        self.places.leave(self)
        self._stop_watching()
        super().connection_lost(exc)

    def send_400_response(self, msg: str) -> None:
        """The refusal of what is no HTTP, or too long a head, as the contract writes it."""
        most = self.limits.max_head_bytes
        error = InvalidRequest(f"{msg} Expected HTTP/1.1 with a head of at most {most} bytes")
        body = json.dumps(error.to_dict()).encode()
        headers = [
            ("content-type", "application/json"),
            ("content-length", str(len(body))),
            ("connection", "close"),
        ]
        if self.conn.our_state not in (h11.IDLE, h11.SEND_RESPONSE):
            self.transport.abort()  # an answer has begun: nothing can be said any more
            return
        for event in (
            h11.Response(status_code=400, headers=headers, reason="Bad Request"),
            h11.Data(data=body),
            h11.EndOfMessage(),
        ):
            self.transport.write(self.conn.send(event) or b"")
        self.transport.close()

    def has_sent_all(self) -> bool:
        """Whether the client has what was written for it, as far as can be told from here."""
        return self.transport.get_write_buffer_size() == 0

    def _watch(self) -> None:
        """Limit the time while a head or a body is still coming in."""
        self._note_place()
        receives_body = self.conn.their_state is h11.SEND_BODY
        if not receives_body and self.conn.their_state is not h11.IDLE:
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

    def _note_place(self) -> None:
        """Whether it has a request is what its place depends on."""
        if self.cycle is None or self.cycle.response_complete:
            self.places.begin_waiting(self)
        else:
            self.places.begin_request(self)


def limited(limits: ConnectionLimits) -> type[LimitedConnection]:
    """The protocol of one server for `uvicorn.Config(http=…)`, within these limits."""
    attributes = {"limits": limits, "places": limits.places()}
    return type("LimitedConnection", (LimitedConnection,), attributes)


def health_alone(app: ASGIApp) -> ASGIApp:
    """The application to a connection too many: health is answered, all else is `overloaded`."""

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["path"].startswith(HEALTH):
            await app(scope, receive, send)
            return
        await discard_body(Request(scope, receive))
        error = Overloaded("too many connections; try again in 1 s", retry_after_s=1)
        await error_answer(error, {"Connection": "close"})(scope, receive, send)

    return answer
