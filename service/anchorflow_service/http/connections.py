"""Bounds on connections: how many there are, and how long each may take to send and to receive.

uvicorn's `limit_concurrency` refuses health checks too, and uvicorn has no timeout for a request's
bytes. `AnchorProtocol` is uvicorn's HTTP protocol (its `http` setting) with both bounds: it
overrides callbacks of `asyncio.Protocol` and uvicorn's plain-text refusal of invalid HTTP, and
calls public methods of the transport. `OverloadGuard` is the middleware that notifies a connection
when a request begins and ends. Both use the state of ASGI's lifespan: uvicorn passes it to every
connection, which passes it to its requests.
"""

from __future__ import annotations

import asyncio
import ipaddress
import math
import re
import uuid
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from enum import Enum, auto
from typing import Any

from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from anchorflow_client.errors import InvalidRequest, Overloaded, RequestError
from anchorflow_service.http.exchanges import REQUEST_ID, discard_body
from anchorflow_service.http.responses import error_response
from anchorflow_service.http.tokens import HEALTH
from anchorflow_service.observability.logs import UNROUTED, Exchange, Listener

RESERVE = 64
"""Connections beyond the limit that are accepted, so that health checks get through a crowd."""
SHARE_OF_AN_ADDRESS = 0.75
MAX_PIPELINED_BYTES = 64 * 2**10
"""Bytes that a client may send ahead while its request is being answered."""
IPV6_NETWORK_BITS = 64
"""A machine may use any address of its /64 network, so the whole network counts as one."""
SLOTS, CONNECTION = "connection_slots", "connection"
"""Keys in the state of the lifespan and of a request."""
UPGRADE = re.compile(rb"\r\nupgrade:[^\r\n]*", re.IGNORECASE)


@dataclass(frozen=True)
class ConnectionLimits:
    """Bounds on connections and on what they send."""

    max_connections: int = 512
    """If all of these have a request, requests on further ones are `overloaded`, except health;
    otherwise the connection that has been idle longest is closed for a new one."""
    max_per_address: int | None = None
    """Connections of one address; None: three quarters of all."""
    max_head_bytes: int = 16 * 2**10
    """Size of a request line and its headers."""
    head_s: float = 10.0
    """Time for the request line and headers to arrive; then the connection is closed."""
    receive_s: float = 60.0
    """Time for the body after them; then the connection is closed."""
    send_s: float = 60.0
    """Time in which a client must take some of a response that fills the buffers; then the
    connection is closed."""


class ConnectionSlots:
    """Keeps a bounded number of connections: those in a slot, and a few in a reserve.

    A connection without a request is idle and loses little by being closed. A new connection takes
    the slot of the one that has been idle longest: among those of its own address if that has its
    share, else among all. If none is idle, the new one waits in the reserve.
    """

    def __init__(self, limits: ConnectionLimits, listeners: Sequence[Listener] = ()) -> None:
        """listeners: called for refusals of what is not a request."""
        self.limits = limits
        self.listeners = listeners
        share = math.ceil(SHARE_OF_AN_ADDRESS * limits.max_connections)
        self._max_per_source = share if limits.max_per_address is None else limits.max_per_address
        self._slots: dict[AnchorProtocol, str | None] = {}
        """The source of each."""
        self._reserve: dict[AnchorProtocol, None] = {}
        self._idle: dict[AnchorProtocol, None] = {}
        """The one that has been idle longest comes first."""

    def enter(self, connection: AnchorProtocol, source: str | None) -> bool:
        """Add a new, idle connection; return whether it has a slot.

        source: see `source_of`; None: no share applies
        """
        same = {each for each, other in self._slots.items() if other == source}
        if source is not None and len(same) >= self._max_per_source:
            has_slot = self._close_idle(same)
        elif len(self._slots) >= self.limits.max_connections:
            has_slot = self._close_idle(self._slots)
        else:
            has_slot = True
        if has_slot:
            self._slots[connection] = source
        else:
            if len(self._reserve) >= RESERVE and not self._close_idle(self._reserve):
                self._close(next(iter(self._reserve)))
            self._reserve[connection] = None
        self._idle[connection] = None
        return has_slot

    def mark_busy(self, connection: AnchorProtocol) -> None:
        """Note that the connection has a request, so that it is not closed for another one."""
        self._idle.pop(connection, None)

    def mark_idle(self, connection: AnchorProtocol) -> None:
        if connection in self._slots or connection in self._reserve:
            self._idle[connection] = None

    def leave(self, connection: AnchorProtocol) -> None:
        """Remove a closed connection; it may have been removed before."""
        for group in (self._slots, self._reserve, self._idle):
            group.pop(connection, None)

    def _close_idle(self, among: Collection[AnchorProtocol]) -> bool:
        idle = (each for each in self._idle if each in among and each.has_sent_all)
        if (first := next(idle, None)) is None:
            return False
        self._close(first)
        return True

    def _close(self, connection: AnchorProtocol) -> None:
        self.leave(connection)
        connection.abort()


class Phase(Enum):
    """The part of an exchange that a connection waits for."""

    HEAD = auto()
    """A request, or the rest of its line and headers."""
    BODY = auto()
    """The rest of a body."""
    RESPONSE = auto()
    """The response."""


class AnchorProtocol(HttpToolsProtocol):
    """A connection that closes itself when it breaks the limits."""

    def __init__(self, *, app_state: dict[str, Any], **options: Any) -> None:
        super().__init__(app_state={**app_state, CONNECTION: self}, **options)
        self._bounds: ConnectionSlots = app_state[SLOTS]
        self._phase = Phase.HEAD
        self._unparsed = 0
        """Bytes that arrived since the last complete request."""
        self._close_after_response = False
        self._receive_timer: asyncio.TimerHandle | None = None
        self._send_timer: asyncio.TimerHandle | None = None
        self.has_slot = True

    @property
    def has_sent_all(self) -> bool:
        """Whether nothing of a response is left in this process."""
        return not self.transport.get_write_buffer_size()

    @property
    def expects_body(self) -> bool:
        """Whether the body of the current request is incomplete."""
        return self._phase is Phase.BODY

    def abort(self) -> None:
        self.transport.abort()

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a slot or a place in the reserve, and wait for the first request."""
        super().connection_made(transport)
        peer = transport.get_extra_info("peername")
        source = source_of(peer[0]) if isinstance(peer, tuple) else None
        self.has_slot = self._bounds.enter(self, source)
        self._limit_receiving(self._bounds.limits.head_s)

    def data_received(self, data: bytes) -> None:
        """Parse what arrived, within the bounds on time and on size."""
        limits = self._bounds.limits
        if self._phase is Phase.HEAD:
            if not self._unparsed:
                data = _without_upgrade(data, limits.max_head_bytes)
            if self._receive_timer is None:
                self._limit_receiving(limits.head_s)
        if self._phase is not Phase.BODY:
            self._unparsed += len(data)
        super().data_received(data)
        if self._phase is Phase.HEAD and self._unparsed > limits.max_head_bytes:
            # A request that is complete has begun by then.
            asyncio.get_running_loop().call_soon(self._check_head)
        elif self._phase is Phase.RESPONSE and self._unparsed > MAX_PIPELINED_BYTES:
            self.abort()

    def pause_writing(self) -> None:
        """Limit the time in which the client takes nothing of a response."""
        super().pause_writing()
        self._limit_sending(math.inf)

    def resume_writing(self) -> None:
        """Lift that limit: the buffer is all but empty."""
        super().resume_writing()
        if self._send_timer is not None:
            self._send_timer.cancel()

    def connection_lost(self, exc: Exception | None) -> None:
        self._bounds.leave(self)
        for timer in (self._receive_timer, self._send_timer):
            if timer is not None:
                timer.cancel()
        super().connection_lost(exc)

    def send_400_response(self, msg: str) -> None:
        """Refuse what is not valid HTTP as the contract does; a response under way comes first."""
        if self._phase is Phase.RESPONSE:
            self._close_after_response = True
            return
        request_id = uuid.uuid4().hex
        error = _invalid_head(msg, self._bounds.limits.max_head_bytes)
        refusal = error_response(error, {REQUEST_ID: request_id, "Connection": "close"})
        head = b"".join(b"%b: %b\r\n" % header for header in refusal.raw_headers)
        self.transport.write(b"HTTP/1.1 400 Bad Request\r\n%b\r\n%b" % (head, refusal.body))
        self.transport.close()
        if self._phase is Phase.HEAD:  # else the request's own exchange is counted
            for listener in self._bounds.listeners:
                listener(Exchange("-", "-", UNROUTED, 400, 0.0, request_id, None))

    def begin_request(self, *, has_body: bool) -> None:
        self._bounds.mark_busy(self)
        self._limit_receiving(self._bounds.limits.receive_s if has_body else None)
        self._phase, self._unparsed = Phase.BODY if has_body else Phase.RESPONSE, 0

    def end_body(self) -> None:
        self._phase = Phase.RESPONSE
        self._limit_receiving(None)

    def end_request(self) -> None:
        """Note that its response is complete; uvicorn limits the wait for the next request."""
        if self._close_after_response or self.expects_body:
            self.transport.close()
        self._bounds.mark_idle(self)
        self._phase, self._unparsed = Phase.HEAD, 0

    def refusal(self, scope: Scope) -> RequestError | None:
        """Return why the request is not answered on this connection, if it is not."""
        most = self._bounds.limits.max_head_bytes
        target = len(scope["raw_path"]) + len(scope["query_string"])
        if target + sum(len(name) + len(value) + 4 for name, value in scope["headers"]) > most:
            return _invalid_head("The head is too long.", most)
        if self.has_slot or scope["path"].startswith(HEALTH):
            return None
        return Overloaded("too many connections; try again in 1 s", retry_after_s=1)

    def _check_head(self) -> None:
        is_too_long = self._unparsed > self._bounds.limits.max_head_bytes
        if self._phase is Phase.HEAD and is_too_long and not self.transport.is_closing():
            self.send_400_response("The head is too long.")

    def _limit_receiving(self, limit_s: float | None) -> None:
        if self._receive_timer is not None:
            self._receive_timer.cancel()
        loop = asyncio.get_running_loop()
        self._receive_timer = None if limit_s is None else loop.call_later(limit_s, self.abort)

    def _limit_sending(self, left_before: float) -> None:
        left = self.transport.get_write_buffer_size()
        if left >= left_before:
            self.abort()
            return
        self._send_timer = asyncio.get_running_loop().call_later(
            self._bounds.limits.send_s, self._limit_sending, left
        )


class OverloadGuard:
    """Middleware: on a connection in the reserve only health is answered, the rest `overloaded`."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on or refuse it, and report its progress to its connection."""
        connection = scope.get("state", {}).get(CONNECTION)
        if scope["type"] != "http" or connection is None:  # another server's connection
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        has_body = headers.get("content-length", "0") != "0" or "transfer-encoding" in headers
        connection.begin_request(has_body=has_body)

        async def receive_body() -> Message:
            message = await receive()
            if has_body and message["type"] == "http.request" and not message.get("more_body"):
                connection.end_body()
            return message

        async def send_after_body(message: Message) -> None:
            # Most clients look for the response only after they have sent the whole body.
            if connection.expects_body and message["type"] == "http.response.start":
                await discard_body(Request(scope, receive_body))
            await send(message)

        try:
            error = connection.refusal(scope)
            if error is None:
                await self._app(scope, receive_body, send_after_body)
            else:
                refused = error_response(error, {"Connection": "close"})
                await refused(scope, receive_body, send_after_body)
        finally:
            connection.end_request()


def source_of(address: str) -> str:
    """Return what an address counts as: itself, or its network in IPv6."""
    try:
        ip = ipaddress.ip_address(address)
    except ValueError:
        return address
    if ip.version == 4:
        return str(ip)
    if ip.ipv4_mapped is not None:
        return str(ip.ipv4_mapped)
    return str(ipaddress.ip_network((int(ip), IPV6_NETWORK_BITS), strict=False))


def _invalid_head(reason: str, max_bytes: int) -> InvalidRequest:
    expected = f"Expected HTTP/1.1 with a head of at most {max_bytes} bytes"
    return InvalidRequest(f"{reason} {expected}", http_status=400)


def _without_upgrade(data: bytes, max_head_bytes: int) -> bytes:
    """Remove an Upgrade header, as Java's client sends: the parser would leave the body unread."""
    if UPGRADE.search(data, 0, max_head_bytes) is None:
        return data
    head, end, body = data.partition(b"\r\n\r\n")
    return UPGRADE.sub(b"", head) + end + body
