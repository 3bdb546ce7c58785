"""A body over the limit is refused before it is in memory."""

from __future__ import annotations

import http.client
import socket
from collections.abc import AsyncIterator, Callable, Iterator
from typing import Any
from urllib.parse import urlsplit

import pytest
from fastapi import FastAPI

from anchorflow_service.http import exchanges

MEBIBYTE = 2**20


def assert_too_large(status: int, body: bytes) -> None:
    assert status == 413
    assert b'"too_large"' in body
    assert b'"field":"body"' in body
    assert b"at most 16777216 bytes" in body


class Megabytes:
    """A body of 20 MiB in pieces, which counts those that were read."""

    def __init__(self) -> None:
        self.taken = 0

    async def __aiter__(self) -> AsyncIterator[bytes]:
        for _ in range(20):
            self.taken += 1
            yield bytes(MEBIBYTE)


DECLARED = {"Content-Length": str(20 * MEBIBYTE)}


def test_a_refused_body_is_read_within_bounds(
    service: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exchanges, "MAX_DISCARDED_BYTES", 2 * MEBIBYTE)
    body = Megabytes()

    answer = service.request("POST", "/anchors", headers=DECLARED, content=body)

    assert_too_large(answer.status_code, answer.content)
    assert body.taken == 3


def declared(length: int) -> dict[str, Any]:
    return {"body": bytes(length)}


def chunked(length: int) -> dict[str, Any]:
    def pieces() -> Iterator[bytes]:
        yield from [bytes(MEBIBYTE)] * (length // MEBIBYTE)

    return {"body": pieces(), "encode_chunked": True, "headers": {"Transfer-Encoding": "chunked"}}


@pytest.mark.parametrize("form", [declared, chunked])
def test_over_a_socket_the_refusal_arrives(
    app: FastAPI, listen: Callable[[FastAPI], str], form: Callable[[int], dict[str, Any]]
) -> None:
    address = urlsplit(listen(app))
    connection = http.client.HTTPConnection(address.hostname or "", address.port, timeout=20)
    connection.request("POST", "/anchors", **form(20 * MEBIBYTE))
    answer = connection.getresponse()

    assert_too_large(answer.status, answer.read())
    connection.close()


WAITS = b"Host: a\r\nExpect: 100-continue\r\n"
LIVE = b"GET /v2/health/live HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n"


def test_a_body_is_requested_from_a_client_that_waits_for_it(
    app: FastAPI, listen: Callable[[FastAPI], str]
) -> None:
    address = urlsplit(listen(app))
    with socket.create_connection((address.hostname, address.port or 0), timeout=20) as connection:
        connection.sendall(b"POST /anchors HTTP/1.1\r\n%bContent-Length: 2\r\n\r\n" % WAITS)
        answers = connection.makefile("rb")
        assert answers.readline() == b"HTTP/1.1 100 Continue\r\n"
        connection.sendall(b"{}" + LIVE)
        rest = answers.read()

    assert b"HTTP/1.1 422 " in rest
    assert b"HTTP/1.1 200 " in rest
