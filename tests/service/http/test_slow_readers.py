"""Clients that read a response slowly or not at all, with and without TLS."""

from __future__ import annotations

import socket
import ssl
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
import trustme
from starlette.requests import Request
from starlette.responses import Response

from anchorflow_service.http import create_app
from anchorflow_service.http.connections import ConnectionLimits
from anchorflow_service.http.lifecycle import TlsFiles
from anchorflow_service.planning import PlanningService

PATIENCE_S = 20
LARGE = 16 * 2**20
"""Bytes of a response that no system takes at once."""
PART = 2**19

Connect = Callable[[], socket.socket]
Within = Callable[..., Connect]


@pytest.fixture(params=["plain", "tls"])
def within(
    request: pytest.FixtureRequest,
    planning: PlanningService,
    serve: Callable[..., Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> Iterator[Within]:
    """Serves large responses within limits; gives what connects with little room to receive."""

    async def large(_: Request) -> Response:
        return Response(bytes(LARGE))

    ours = theirs = None
    if request.param == "tls":
        monkeypatch.setattr("asyncio.constants.SSL_SHUTDOWN_TIMEOUT", 0.5)  # in place of 30 s
        authority = trustme.CA()
        ours = TlsFiles(tmp_path / "both.pem", tmp_path / "both.pem")
        authority.issue_cert("localhost").private_key_and_cert_chain_pem.write_to_path(
            tmp_path / "both.pem"
        )
        theirs = ssl.create_default_context()
        authority.configure_trust(theirs)
    with ExitStack() as stack:

        def start(limits: ConnectionLimits) -> Connect:
            app = create_app(planning, connections=limits)
            app.add_route("/large", large)
            port = serve(app, tls=ours).port

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
def test_a_client_that_takes_nothing_of_a_response_loses_its_slot(
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


def test_a_response_may_take_longer_as_long_as_some_of_it_is_taken(within: Within) -> None:
    connection = within(ConnectionLimits(send_s=0.5))()
    ask(connection, "/large")

    began, received = time.monotonic(), 0
    while received < LARGE:
        part = connection.recv(PART)
        assert part
        received += len(part)
        time.sleep(1.5 * len(part) / LARGE)

    assert time.monotonic() - began > 1.0
