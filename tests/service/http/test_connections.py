"""What a connection may cost: how many, how large a head, how long."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import pytest
from fastapi import FastAPI

from anchorflow_client import AnchorClient, Overloaded
from anchorflow_service.http.connections import RESERVE, ConnectionLimits
from anchorflow_service.http.lifecycle import AnchorServer
from anchorflow_service.planning import PlanningService

Within = Callable[[ConnectionLimits], int]


@pytest.fixture
def within(app: FastAPI, planning: PlanningService, serve: Callable[[AnchorServer], Any]) -> Within:
    """Starts the application within limits; gives its port."""
    return lambda limits: serve(AnchorServer(app, planning, limits=limits)).port


def everything(connection: socket.socket) -> bytes:
    """What comes until the other side closes, in whichever way."""
    connection.settimeout(20)
    parts = []
    try:
        while part := connection.recv(65536):
            parts.append(part)
    except ConnectionResetError:
        pass
    return b"".join(parts)


def error_of(answer: bytes) -> dict[str, Any]:
    head, _, body = answer.partition(b"\r\n\r\n")
    assert b"application/json" in head
    return json.loads(body)["error"]


def test_a_connection_too_many_is_overloaded_and_health_is_answered(
    within: Within, fields: dict[str, Any]
) -> None:
    port = within(ConnectionLimits(max_connections=2))
    with ExitStack() as stack:
        for _ in range(2):
            stack.enter_context(socket.create_connection(("127.0.0.1", port)))
        client = stack.enter_context(AnchorClient(f"http://127.0.0.1:{port}", timeout_s=20))
        assert client.ready()
        with pytest.raises(Overloaded, match="too many connections") as caught:
            client.plan(**fields)
        assert caught.value.retry_after_s == 1

    with AnchorClient(f"http://127.0.0.1:{port}", timeout_s=20) as client:
        deadline = time.monotonic() + 20
        while True:  # the server learns of the closed connections a moment later
            try:
                assert client.plan(**fields).seed == 1
                break
            except Overloaded:
                assert time.monotonic() < deadline
                client.close()
                time.sleep(0.05)


def test_a_crowd_is_not_even_heard(within: Within) -> None:
    port = within(ConnectionLimits(max_connections=1))
    with ExitStack() as stack:
        crowd = [
            stack.enter_context(socket.create_connection(("127.0.0.1", port)))
            for _ in range(1 + RESERVE + 3)
        ]

        assert [everything(late) for late in crowd[-3:]] == [b"", b"", b""]
        crowd[0].sendall(b"GET /v2/health/live HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n")
        assert everything(crowd[0]).startswith(b"HTTP/1.1 200 ")


@pytest.mark.parametrize(
    "sent",
    [
        b"GET /v2 HTTP/1.1\r\nHost: a\r\nX-Long: " + b"x" * 2000,
        b"GET /" + b"x" * 2000,
        b"nonsense\r\n\r\n",
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03\r\n\r\n",
        b"POST /anchors HTTP/1.1\r\nHost: a\r\nContent-Length: -1\r\n\r\n",
        b"POST /anchors HTTP/1.1\r\nHost: a\r\nTransfer-Encoding: gzip\r\n\r\n",
        b"GET /v2 HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n",
    ],
)
def test_what_is_no_request_is_refused_in_the_contracts_words(within: Within, sent: bytes) -> None:
    port = within(ConnectionLimits(max_head_bytes=1000))
    with socket.create_connection(("127.0.0.1", port)) as connection:
        connection.sendall(sent)
        answer = everything(connection)

    assert answer.startswith(b"HTTP/1.1 400 ")
    error = error_of(answer)
    assert error["code"] == "invalid_request"
    assert "at most 1000 bytes" in error["message"]


@pytest.mark.parametrize(
    "sent",
    [
        b"",
        b"GET /v2 HT",
        b"POST /anchors HTTP/1.1\r\nHost: a\r\nContent-Length: 100\r\n\r\nhalf",
        b"GET /v2/health/live HTTP/1.1\r\nHost: a\r\n\r\nGET /v2 HT",
    ],
)
def test_a_request_that_does_not_come_is_not_waited_for(within: Within, sent: bytes) -> None:
    port = within(ConnectionLimits(receive_s=0.2))
    with socket.create_connection(("127.0.0.1", port)) as connection:
        connection.sendall(sent)
        began = time.monotonic()
        everything(connection)

        assert time.monotonic() - began < 15


def test_bytes_that_drip_do_not_prolong_the_wait(within: Within) -> None:
    port = within(ConnectionLimits(receive_s=0.3))
    with socket.create_connection(("127.0.0.1", port)) as connection:
        connection.sendall(b"GET /v2 HTTP/1.1\r\nX: ")
        connection.settimeout(0.05)
        for _ in range(200):
            connection.sendall(b"x")
            try:
                assert connection.recv(100) == b""
                return
            except TimeoutError:
                continue
            except ConnectionResetError:
                return
    pytest.fail("it waits for as long as bytes come")


def test_planning_may_take_longer_than_receiving(
    within: Within, fields: dict[str, Any], engine: Any
) -> None:
    def slowly(batch: Any) -> Any:
        time.sleep(0.5)
        return batch

    engine.before_answer = slowly
    port = within(ConnectionLimits(receive_s=0.2))
    with AnchorClient(f"http://127.0.0.1:{port}", timeout_s=20) as client:
        assert client.plan(**fields).seed == 1
        assert client.plan(**fields).seed == 1  # and again over the same connection
