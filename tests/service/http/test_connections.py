"""Bounds on connections over real sockets: how many, how large a head, how long."""

from __future__ import annotations

import json
import re
import socket
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, contextmanager
from typing import Any

import pytest

from anchorflow_client import AnchorClient, Overloaded
from anchorflow_service.http import create_app
from anchorflow_service.http.connections import MAX_PIPELINED_BYTES, RESERVE, ConnectionLimits
from anchorflow_service.planning import PlanningService

Within = Callable[[ConnectionLimits], int]
Busy = Callable[[int], AbstractContextManager[None]]
PATIENCE_S = 20
POST = b"POST /anchors HTTP/1.1\r\nHost: a\r\n"
LIVE = b"GET /v2/health/live HTTP/1.1\r\nHost: a\r\n\r\n"
HALF_A_BODY = POST + b"Connection: close\r\nContent-Length: 100\r\n\r\nhalf"


@pytest.fixture
def within(planning: PlanningService, serve: Callable[..., Any]) -> Within:
    """Starts the application within limits; gives its port."""
    return lambda limits: serve(create_app(planning, connections=limits)).port


@pytest.fixture
def busy(gate: Any, fields: dict[str, Any], background: ThreadPoolExecutor) -> Busy:
    """Keeps a request on the engine for the length of a block, and checks its answer then."""

    @contextmanager
    def planning(port: int) -> Iterator[None]:
        asked = background.submit(ask, port, fields)
        assert gate.reached.wait(PATIENCE_S)
        yield
        gate.opened.set()
        assert asked.result(PATIENCE_S) == 1

    return planning


def everything(connection: socket.socket) -> bytes:
    """Return all bytes until the server closes the connection."""
    connection.settimeout(PATIENCE_S)
    parts = []
    try:
        while part := connection.recv(65536):
            parts.append(part)
    except ConnectionResetError:
        pass
    return b"".join(parts)


def exchange(port: int, sent: bytes) -> bytes:
    """Send bytes over a connection of their own, and return all that comes back."""
    with socket.create_connection(("127.0.0.1", port)) as connection:
        connection.sendall(sent)
        return everything(connection)


def error_of(answer: bytes) -> dict[str, Any]:
    head, _, body = answer.partition(b"\r\n\r\n")
    assert b"application/json" in head
    return json.loads(body)["error"]


def ask(port: int, fields: dict[str, Any]) -> int:
    """The seed of an answer, over a connection of its own."""
    with AnchorClient(f"http://127.0.0.1:{port}", timeout_s=PATIENCE_S) as client:
        return client.plan(**fields).seed


def is_ready(port: int) -> bool:
    """Asked over a connection of its own."""
    with AnchorClient(f"http://127.0.0.1:{port}", timeout_s=PATIENCE_S) as client:
        return client.ready()


def silent(port: int, stack: ExitStack, address: str = "127.0.0.1") -> socket.socket:
    """A connection from an address of this machine, which sends nothing by itself."""
    return stack.enter_context(
        socket.create_connection(("127.0.0.1", port), source_address=(address, 0))
    )


def is_heard(connection: socket.socket) -> bool:
    """Whether what it asks now is answered; it is closed then."""
    try:
        connection.sendall(b"GET /v2 HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n")
    except OSError:
        return False
    return everything(connection).startswith(b"HTTP/1.1 200 ")


def test_where_all_have_a_request_one_more_is_overloaded_and_health_is_answered(
    within: Within, busy: Busy, fields: dict[str, Any]
) -> None:
    port = within(ConnectionLimits(max_connections=1))
    with busy(port), AnchorClient(f"http://127.0.0.1:{port}", timeout_s=PATIENCE_S) as client:
        assert client.ready()
        with pytest.raises(Overloaded, match="too many connections") as caught:
            client.plan(**fields)
        assert caught.value.retry_after_s == 1
    assert ask(port, fields) == 1


def test_the_connection_that_has_waited_longest_makes_room(
    within: Within, fields: dict[str, Any]
) -> None:
    port = within(ConnectionLimits(max_connections=2))
    with ExitStack() as stack:
        oldest, newer = silent(port, stack), silent(port, stack)

        assert ask(port, fields) == 1
        assert everything(oldest) == b""
        assert is_heard(newer)


def test_a_client_whose_idle_connection_made_room_opens_another(
    within: Within, fields: dict[str, Any]
) -> None:
    port = within(ConnectionLimits(max_connections=1))
    with AnchorClient(f"http://127.0.0.1:{port}", timeout_s=PATIENCE_S) as client:
        for _ in range(3):
            assert client.plan(**fields).seed == 1
            assert ask(port, fields) == 1


def test_a_request_that_has_come_keeps_its_place_in_a_crowd(within: Within, busy: Busy) -> None:
    port = within(ConnectionLimits(max_connections=2))
    with busy(port), ExitStack() as stack:
        crowd = [silent(port, stack) for _ in range(RESERVE + 10)]

        assert [everything(each) for each in crowd[:-1]] == [b""] * (len(crowd) - 1)
        assert is_heard(crowd[-1])


def test_an_address_that_has_its_share_makes_room_among_its_own(within: Within) -> None:
    port = within(ConnectionLimits(max_connections=4, max_per_address=2))
    with ExitStack() as stack:
        other = silent(port, stack, "127.0.0.2")
        crowd = [silent(port, stack) for _ in range(5)]

        assert [everything(each) for each in crowd[:3]] == [b""] * 3
        assert all(map(is_heard, (other, *crowd[3:])))


def test_an_address_whose_share_is_at_work_leaves_the_rest_to_others(
    within: Within, busy: Busy
) -> None:
    port = within(ConnectionLimits(max_connections=2, max_per_address=1))
    with busy(port), ExitStack() as stack:
        assert not is_heard(silent(port, stack))  # but refused
        assert is_heard(silent(port, stack, "127.0.0.2"))
        assert is_ready(port)


def test_bodies_that_are_to_be_refused_do_not_keep_probes_out(within: Within, busy: Busy) -> None:
    """They are taken and thrown away first, for the client to look for the answer."""
    port = within(ConnectionLimits(max_connections=1))
    with busy(port), ExitStack() as stack:
        for _ in range(RESERVE + 5):
            silent(port, stack).sendall(HALF_A_BODY)
        assert is_ready(port)


@pytest.mark.parametrize(
    "sent",
    [
        b"GET /v2 HTTP/1.1\r\nHost: a\r\nX-Long: " + b"x" * 2000,
        b"GET /" + b"x" * 2000,
        b"GET /" + b"x" * 1000 + b" HTTP/1.1\r\nHost: a\r\n\r\n",
        b"GET /v2 HTTP/1.1\r\nHost: a\r\n" + b"a:b\r\n" * 200 + b"\r\n",
        b"nonsense\r\n\r\n",
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03\r\n\r\n",
        POST + b"Content-Length: -1\r\n\r\n",
        POST + b"Transfer-Encoding: gzip\r\n\r\n",
        POST + b"Transfer-Encoding: chunked\r\n\r\nnonsense\r\n",
    ],
)
def test_what_is_no_request_is_refused_in_the_contracts_words(within: Within, sent: bytes) -> None:
    answer = exchange(within(ConnectionLimits(max_head_bytes=1000)), sent)

    assert answer.startswith(b"HTTP/1.1 400 ")
    error = error_of(answer)
    assert error["code"] == "invalid_request"
    assert "at most 1000 bytes" in error["message"]


@pytest.mark.parametrize(
    ("limits", "sent"),
    [
        (ConnectionLimits(head_s=0.2, receive_s=1e6), b""),
        (ConnectionLimits(head_s=0.2, receive_s=1e6), b"GET /v2 HT"),
        (ConnectionLimits(head_s=1e6, receive_s=0.2), HALF_A_BODY),
    ],
    ids=["nothing", "half a head", "half a body"],
)
def test_what_does_not_come_is_not_waited_for(
    within: Within, limits: ConnectionLimits, sent: bytes
) -> None:
    exchange(within(limits), sent)


def test_a_second_head_that_does_not_come_is_not_waited_for_either(within: Within) -> None:
    port = within(ConnectionLimits(head_s=0.2, receive_s=1e6))
    with socket.create_connection(("127.0.0.1", port)) as connection:
        connection.settimeout(PATIENCE_S)
        connection.sendall(LIVE)
        while b"true}" not in connection.recv(65536):
            pass
        connection.sendall(b"GET /v2 HT")
        everything(connection)


def test_a_body_has_a_time_of_its_own(within: Within) -> None:
    port = within(ConnectionLimits(head_s=0.2, receive_s=1e6))
    with ExitStack() as stack:
        connection = silent(port, stack)
        connection.sendall(HALF_A_BODY)
        everything(silent(port, stack))  # the limit for a head
        connection.sendall(b"-" * (100 - len(b"half")))

        assert error_of(everything(connection))["code"] == "invalid_request"


def test_bytes_that_drip_do_not_prolong_the_wait(within: Within) -> None:
    port = within(ConnectionLimits(head_s=0.3))
    with socket.create_connection(("127.0.0.1", port)) as connection:
        connection.sendall(b"GET /v2 HTTP/1.1\r\nX: ")
        connection.settimeout(0.05)
        for _ in range(200):
            try:
                connection.sendall(b"x")
                assert connection.recv(100) == b""
                return
            except TimeoutError:  # noqa: PERF203 - one of many is waited for
                continue
            except ConnectionError:
                return
    pytest.fail("it waits for as long as bytes come")


def test_planning_may_take_longer_than_receiving(
    within: Within, fields: dict[str, Any], gate: Any, background: ThreadPoolExecutor
) -> None:
    port = within(ConnectionLimits(head_s=0.2, receive_s=0.2))
    with ExitStack() as stack:
        client = AnchorClient(f"http://127.0.0.1:{port}", timeout_s=PATIENCE_S)
        asked = background.submit(stack.enter_context(client).plan, **fields)
        assert gate.reached.wait(PATIENCE_S)
        for sent in (b"", HALF_A_BODY):  # beyond the limits of head and body
            connection = silent(port, stack)
            connection.sendall(sent)
            everything(connection)
        gate.opened.set()

        assert asked.result(PATIENCE_S).seed == 1
        assert client.plan(**fields).seed == 1  # and again over the same connection


def counted(port: int) -> dict[tuple[str, str], float]:
    """HTTP answers by route and status, those to this question left out."""
    sent = b"GET /metrics HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n"
    text = exchange(port, sent).partition(b"\r\n\r\n")[2].decode()
    pattern = r'^anchorflow_http_responses_total{route="(.*)",status="(.*)"} (.*)$'
    found = re.findall(pattern, text, re.M)
    return {(route, status): float(n) for route, status, n in found if route != "/metrics"}


def test_who_is_refused_for_want_of_a_connection_is_counted_and_logged(
    within: Within, busy: Busy, caplog: pytest.LogCaptureFixture, until: Any
) -> None:
    port = within(ConnectionLimits(max_connections=1))
    with busy(port), caplog.at_level("INFO", "anchorflow_service.access"):
        answer = exchange(port, b"GET /v2 HTTP/1.1\r\nHost: a\r\nX-Request-Id: r7\r\n\r\n")

    assert answer.startswith(b"HTTP/1.1 429 ")
    assert b"x-request-id: r7" in answer.lower()
    assert [record.getMessage()[:12] for record in caplog.records] == ["GET /v2 429 "]
    until(lambda: counted(port) == {("other", "429"): 1, ("/anchors", "200"): 1})


def test_what_is_no_request_is_counted_once(within: Within, until: Any) -> None:
    port = within(ConnectionLimits())
    answer = exchange(port, b"nonsense\r\n\r\n")

    assert re.search(rb"^x-request-id: \w{32}\r$", answer.lower(), re.M)
    until(lambda: counted(port) == {("other", "400"): 1})


def test_who_leaves_in_mid_body_is_counted_as_gone(within: Within, until: Any) -> None:
    port = within(ConnectionLimits())
    with ExitStack() as stack:
        silent(port, stack).sendall(HALF_A_BODY)

    until(lambda: counted(port).get(("/anchors", "499")))


def posted(fields: dict[str, Any]) -> bytes:
    body = json.dumps(fields).encode()
    return POST + b"Content-Length: %d\r\n\r\n%b" % (len(body), body)


@pytest.mark.parametrize(
    "more",
    [
        b"nonsense\r\n\r\n",
        POST + b"Transfer-Encoding: chunked\r\n\r\nnonsense\r\n",
    ],
    ids=["no request", "no chunk"],
)
def test_a_refusal_does_not_come_before_the_answer_to_what_came_first(
    within: Within, fields: dict[str, Any], gate: Any, more: bytes
) -> None:
    with socket.create_connection(("127.0.0.1", within(ConnectionLimits()))) as connection:
        connection.sendall(posted(fields))
        assert gate.reached.wait(PATIENCE_S)
        connection.sendall(more)
        gate.opened.set()
        answer = everything(connection)

    assert answer.count(b"HTTP/1.1 ") == 1
    assert answer.startswith(b"HTTP/1.1 200 ")


def test_requests_that_come_at_once_are_answered_in_their_order(within: Within) -> None:
    last = b"GET /v2/health/ready HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n"
    answer = exchange(within(ConnectionLimits(max_head_bytes=100)), LIVE * 5 + last)

    assert answer.count(b"HTTP/1.1 200 ") == 6
    assert answer.count(b'{"live":true}') == 5
    assert answer.endswith(b'{"ready":true}')


UPGRADE = b"Connection: Upgrade, HTTP2-Settings\r\nUpgrade: h2c\r\nHTTP2-Settings: AAM\r\n"
"""As Java's client and `curl --http2` ask first."""


@pytest.mark.parametrize("is_chunked", [False, True])
def test_a_client_that_offers_another_protocol_is_answered_in_this_one(
    within: Within, fields: dict[str, Any], is_chunked: bool
) -> None:
    """The body too, and again over the same connection."""
    body = json.dumps(fields).encode()
    framed, framing = body, b"Content-Length: %d\r\n" % len(body)
    if is_chunked:
        framing = b"Transfer-Encoding: chunked\r\n"
        framed = b"%x\r\n%b\r\n0\r\n\r\n" % (len(body), body)
    head = POST + UPGRADE + framing
    with socket.create_connection(("127.0.0.1", within(ConnectionLimits()))) as connection:
        connection.settimeout(PATIENCE_S)
        for more in (b"", b"Connection: close\r\n"):
            connection.sendall(head + more + b"\r\n" + framed)
            answer = b""
            while not answer.endswith(b"}"):
                answer += connection.recv(65536)
            assert answer.startswith(b"HTTP/1.1 200 ")


def test_a_client_cannot_send_without_end_while_it_is_answered(
    within: Within, fields: dict[str, Any], gate: Any
) -> None:
    with socket.create_connection(("127.0.0.1", within(ConnectionLimits()))) as connection:
        connection.sendall(posted(fields))
        assert gate.reached.wait(PATIENCE_S)
        connection.sendall(b"GET /v2 HTTP/1.1\r\nX: " + b"x" * 2 * MAX_PIPELINED_BYTES)
        assert everything(connection) == b""
