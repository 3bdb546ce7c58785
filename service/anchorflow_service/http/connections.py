"""What a connection may cost before a request stands on it: how many, how long, how large a head.

uvicorn's own limit on concurrency answers health checks with its plain-text refusal too, and it
waits for a request's bytes for ever. Both are decided here, and refusals are the contract's.
"""

from __future__ import annotations

import asyncio
import json
from dataclasses import dataclass

import h11
from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from anchorflow_client.errors import InvalidRequest, Overloaded
from anchorflow_service.http.body import discard_body
from anchorflow_service.http.errors import error_answer
from anchorflow_service.http.guard import HEALTH

RESERVE = 64
"""Connections beyond the limit that are still heard, so that a probe gets through a crowd."""


@dataclass(frozen=True)
class ConnectionLimits:
    """Bounds on sockets and on what has come over them."""

    max_connections: int = 512
    """At a time; requests on further ones are `overloaded`, health excepted."""
    max_head_bytes: int = 16 * 2**10
    """Of a request line and its headers together."""
    receive_s: float = 60.0
    """For a whole request to come in; then the connection is closed."""


class LimitedConnection(H11Protocol):
    """One connection of a server; `limits` is set by the class that `limited` makes."""

    limits = ConnectionLimits()
    _receiving: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Serve it, hear it and refuse, or close it, by how many there are."""
        super().connection_made(transport)
        beyond = len(self.connections) - self.limits.max_connections
        if beyond > RESERVE:
            transport.abort()
            return
        if beyond > 0:
            self.app = health_alone(self.app)  # type: ignore[assignment]
        self._watch()

    def data_received(self, data: bytes) -> None:
        """Take what came, and wait for the rest no longer than the limit."""
        super().data_received(data)
        self._watch()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop waiting."""
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

    def _watch(self) -> None:
        """Count the time while a request is still coming in."""
        if self.conn.their_state not in (h11.IDLE, h11.SEND_BODY):
            self._stop_watching()
        elif self._receiving is None:
            self._receiving = self.loop.call_later(self.limits.receive_s, self.transport.abort)

    def _stop_watching(self) -> None:
        if self._receiving is not None:
            self._receiving.cancel()
            self._receiving = None


def limited(limits: ConnectionLimits) -> type[LimitedConnection]:
    """The protocol for `uvicorn.Config(http=…)`, within these limits."""
    return type("LimitedConnection", (LimitedConnection,), {"limits": limits})


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
