"""Callers who read their answers slowly or not at all, with and without TLS."""

from __future__ import annotations

import asyncio.constants
import socket
import ssl
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import pytest
import trustme
from fastapi import FastAPI
from starlette.requests import Request
from starlette.responses import Response

from anchorflow_service.http.connections import ConnectionLimits
from anchorflow_service.http.lifecycle import AnchorServer
from anchorflow_service.planning import PlanningService

PATIENCE_S = 20
LARGE = 16 * 2**20
"""Bytes of an answer that no system takes at once."""
PART = 2**19

Connect = Callable[[], socket.socket]
Within = Callable[..., Connect]


@pytest.fixture(params=["plain", "tls"])
def within(
    request: pytest.FixtureRequest,
    app: FastAPI,
    planning: PlanningService,
    serve: Callable[[AnchorServer], Any],
) -> Iterator[Within]:
    """Serves large answers within limits; gives what connects with little room to receive."""

    async def large(_: Request) -> Response:
        return Response(bytes(LARGE))

    app.add_route("/large", large)
    ours = theirs = None
    if request.param == "tls":
        authority = trustme.CA()
        ours = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        authority.issue_cert("localhost").configure_cert(ours)
        theirs = ssl.create_default_context()
        authority.configure_trust(theirs)
    with ExitStack() as stack:

        def start(limits: ConnectionLimits, *, keep_alive_s: float = 5.0) -> Connect:
            server = AnchorServer(app, planning, limits=limits, tls=ours)
            server.config.timeout_keep_alive = keep_alive_s  # pyright: ignore[reportAttributeAccessIssue] - uvicorn says whole seconds
            port = serve(server).port

            def connect() -> socket.socket:
                connection = stack.enter_context(socket.socket())
                connection.settimeout(PATIENCE_S)
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2**14)
                connection.connect(("127.0.0.1", port))
                if theirs is not None:
                    connection = theirs.wrap_socket(connection, server_hostname="localhost")
                    stack.enter_context(connection)
                return connection

            return connect

        yield start


def ask(connection: socket.socket, path: str, more: bytes = b"") -> None:
    connection.sendall(b"GET %b HTTP/1.1\r\nHost: a\r\n%b\r\n" % (path.encode(), more))


@pytest.mark.parametrize("more", [b"", b"Connection: close\r\n"], ids=["kept", "closed"])
def test_who_takes_nothing_of_an_answer_loses_the_place(
    within: Within, until: Any, more: bytes
) -> None:
    connect = within(ConnectionLimits(max_connections=1, send_s=0.4))
    stuck = connect()
    ask(stuck, "/large", more)
    assert stuck.recv(1) == b"H"

    def is_heard() -> bool:
        connection = connect()
        ask(connection, "/v2")
        return connection.recv(100).startswith(b"HTTP/1.1 200 ")

    until(is_heard)


def test_an_answer_may_take_longer_as_long_as_some_of_it_is_taken(
    within: Within, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Over TLS longer than asyncio waits for a connection to be closed, too."""
    monkeypatch.setattr(asyncio.constants, "SSL_SHUTDOWN_TIMEOUT", 0.5, raising=False)
    connection = within(ConnectionLimits(send_s=1.0), keep_alive_s=0.5)()
    ask(connection, "/large")

    began, came = time.monotonic(), 0
    while came < LARGE:
        part = connection.recv(PART)
        assert part
        came += len(part)
        time.sleep(3.0 * len(part) / LARGE)

    assert time.monotonic() - began > 2.0
