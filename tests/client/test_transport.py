"""The socket transports, blocking and async, against servers that misbehave in one way each."""

from __future__ import annotations

import os
import socket
import ssl
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, suppress
from typing import Any
from unittest.mock import Mock

import pytest
import trustme

from anchorflow_client.errors import ConnectionFailed, InvalidAnswer, TimedOut
from anchorflow_client.http.answer_parser import AnswerParser
from anchorflow_client.http.async_transport import AsyncSocketTransport
from anchorflow_client.http.transport import Address, SocketTransport

OK = b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\nX-Kind: test\r\n\r\nok"
HEAD = len(
    b"POST /x HTTP/1.1\r\nHost: test\r\nAccept-Encoding: identity\r\nContent-Length: 99\r\n\r\n"
)
Script = Callable[[socket.socket], None]
Reach = Callable[[int], Any]
Serve = Callable[..., Any]


def read_head(connection: socket.socket) -> bytes:
    head = b""
    while b"\r\n\r\n" not in head:
        head += connection.recv(65536)
    return head


def answer(connection: socket.socket) -> None:
    """One answer, then the connection stays open until the client leaves."""
    read_head(connection)
    connection.sendall(OK)


def answer_twice(connection: socket.socket) -> None:
    answer(connection)
    answer(connection)


@pytest.fixture(params=["blocking", "async"])
def reach(request: pytest.FixtureRequest, blocking: Callable[[Any], Any]) -> Reach:
    """Makes a transport to a port of this machine."""

    def make(port: int) -> Any:
        url = f"http://127.0.0.1:{port}"
        if request.param == "blocking":
            return SocketTransport(url, connect_timeout_s=5)
        return blocking(AsyncSocketTransport(url, connect_timeout_s=5, max_connections=2))

    return make


@pytest.fixture
def serve(reach: Reach) -> Iterator[Serve]:
    """Accepts one connection for each script, lets it run and closes the connection."""
    transports: list[Any] = []
    threads: list[threading.Thread] = []

    def start(*scripts: Script) -> Any:
        listener = socket.create_server(("127.0.0.1", 0))

        def run() -> None:
            with listener:
                for script in scripts:
                    connection, _ = listener.accept()
                    with connection:
                        script(connection)

        threads.append(threading.Thread(target=run))
        threads[-1].start()
        transports.append(reach(listener.getsockname()[1]))
        return transports[-1]

    yield start
    for transport in transports:
        transport.close()
    for thread in threads:
        thread.join(10)
        assert not thread.is_alive()


def get(transport: Any, timeout_s: float = 10) -> bytes:
    return transport.send("GET", "/", {}, None, timeout_s)[2]


def test_headers_come_in_lower_case(serve: Serve) -> None:
    status, headers, body = serve(answer).send("POST", "/x", {}, b"body", 10)

    assert (status, headers["x-kind"], body) == (200, "test", b"ok")


def test_the_connection_is_kept(serve: Serve) -> None:
    transport = serve(answer_twice)

    assert [get(transport), get(transport)] == [b"ok", b"ok"]


def test_an_idle_connection_that_was_closed_is_opened_again(serve: Serve) -> None:
    transport = serve(answer, answer)

    assert [get(transport), get(transport)] == [b"ok", b"ok"]


def test_a_connection_that_closes_as_it_is_asked_is_opened_again(serve: Serve) -> None:
    def answer_once(connection: socket.socket) -> None:
        answer(connection)
        read_head(connection)

    transport = serve(answer_once, answer)

    assert [get(transport), get(transport)] == [b"ok", b"ok"]


@pytest.fixture
def secured(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[Script], SocketTransport]]:
    """Makes a transport to a server under TLS, which plays the script on two connections."""
    authority = trustme.CA()
    ours, theirs = ssl.create_default_context(), ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    authority.configure_trust(ours)
    authority.issue_cert("localhost").configure_cert(theirs)
    monkeypatch.setattr(Address, "tls", lambda _: ours)
    with ExitStack() as stack:

        def start(script: Script) -> SocketTransport:
            listener = stack.enter_context(socket.create_server(("127.0.0.1", 0)))

            def run() -> None:
                for _ in range(2):
                    try:
                        accepted = listener.accept()[0]
                    except OSError:  # the test has ended
                        return
                    # Or a short answer may wait for an acknowledgement, and is lost at a close.
                    accepted.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    with theirs.wrap_socket(accepted, server_side=True) as connection:
                        script(connection)

            server = threading.Thread(target=run, daemon=True)
            server.start()
            stack.callback(server.join, 5)
            stack.callback(listener.shutdown, socket.SHUT_RDWR)  # wakes who waits in accept()
            url = f"https://localhost:{listener.getsockname()[1]}"
            transport = SocketTransport(url, connect_timeout_s=5)
            stack.callback(transport.close)
            return transport

        yield start


BODY = bytes(2**18)
"""Of several TLS records: a later one is sent when the first has met nobody."""


@pytest.mark.parametrize("says_so", [False, True])
def test_an_idle_connection_that_was_closed_under_tls_is_opened_again(
    secured: Callable[[Script], SocketTransport], says_so: bool
) -> None:
    closed = threading.Event()

    def answer_and_close(connection: socket.socket) -> None:
        assert isinstance(connection, ssl.SSLSocket)
        left = len(BODY)
        while left > 0:
            left -= len(connection.recv(65536))
        connection.sendall(OK)
        connection.settimeout(0.1)
        with suppress(OSError):
            if says_so:
                connection.unwrap()
        connection.close()
        closed.set()

    transport = secured(answer_and_close)
    for _ in range(2):
        assert transport.send("POST", "/", {}, BODY, 10)[2] == b"ok"
        assert closed.wait(10)


def test_a_refusal_under_tls_is_heard_though_the_body_is_not_taken(
    secured: Callable[[Script], SocketTransport],
) -> None:
    def refuse(connection: socket.socket) -> None:
        read_head(connection)
        connection.sendall(b"HTTP/1.1 413 Too Large\r\nContent-Length: 2\r\n\r\nno")

    assert secured(refuse).send("POST", "/", {}, bytes(2**23), 10)[0] == 413


FORKS = """
import os
import sys
from anchorflow_client.http.transport import SocketTransport

transport = SocketTransport(f"http://127.0.0.1:{sys.argv[1]}", connect_timeout_s=5)

def ask(path):
    return transport.send("GET", path, {}, None, 5)[2].decode()

assert ask("/first") == "/first"
child = os.fork()
paths = [f"/{'parent' if child else 'child'}{n}" for n in range(50)]
assert [ask(path) for path in paths] == paths
if child:
    sys.exit(os.waitpid(child, 0)[1] != 0)
transport.close()
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
def test_a_forked_process_has_a_connection_of_its_own() -> None:
    def echo(connection: socket.socket) -> None:
        with connection:
            while head := connection.recv(65536):  # these heads come in one piece
                path = head.split()[1]
                length = str(len(path)).encode()
                connection.sendall(
                    b"HTTP/1.1 200 OK\r\nContent-Length: " + length + b"\r\n\r\n" + path
                )

    with socket.create_server(("127.0.0.1", 0)) as listener:

        def accept() -> None:
            for _ in range(2):
                threading.Thread(target=echo, args=(listener.accept()[0],), daemon=True).start()

        accepting = threading.Thread(target=accept, daemon=True)
        accepting.start()
        command = [sys.executable, "-c", FORKS, str(listener.getsockname()[1])]
        ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
        assert ended.returncode == 0, ended.stderr
        accepting.join(10)


def test_a_lock_that_was_held_at_a_fork_holds_up_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        url = f"http://127.0.0.1:{listener.getsockname()[1]}"
        transport = SocketTransport(url, connect_timeout_s=5)
        with transport._turn():  # another thread's, which is not in the child
            monkeypatch.setattr(os, "getpid", lambda: -1)
            thread = threading.Thread(target=transport.close, daemon=True)
            thread.start()
            thread.join(10)
            assert not thread.is_alive()


class Scripted:
    """A socket that takes so many bytes of the first call, all later ones, and has an answer."""

    def __init__(self, takes: int) -> None:
        self.sent: list[bytes] = []
        self._takes = takes

    def sendmsg(self, parts: Sequence[bytes]) -> int:
        self.sent.append(b"".join(parts)[: self._takes])
        return len(self.sent[-1])

    def sendall(self, data: bytes) -> None:
        self.sent.append(bytes(data))

    def recv_into(self, buffer: memoryview) -> int:
        buffer[: len(OK)] = OK
        return len(OK)

    def settimeout(self, timeout_s: float) -> None:
        pass

    def setsockopt(self, *option: int) -> None:
        pass


@pytest.mark.parametrize(
    ("takes", "calls"), [(10**6, 1), (0, 3), (10, 3), (HEAD, 2), (HEAD + 9, 2)]
)
def test_a_head_and_its_body_are_sent_at_once_as_far_as_they_are_taken(
    takes: int, calls: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    connection = Scripted(takes)
    monkeypatch.setattr(socket, "create_connection", Mock(return_value=connection))

    SocketTransport("http://test", connect_timeout_s=5).send("POST", "/x", {}, bytes(99), 10)

    head, _, body = b"".join(connection.sent).partition(b"\r\n\r\n")
    assert len(connection.sent) == calls
    assert head.startswith(b"POST /x HTTP/1.1\r\n")
    assert len(head) + 4 == HEAD
    assert body == bytes(99)


def test_a_socket_that_takes_one_part_at_a_time_gets_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on Windows, and under TLS."""
    connection = Scripted(0)
    monkeypatch.delattr(Scripted, "sendmsg")
    monkeypatch.setattr(socket, "create_connection", Mock(return_value=connection))

    SocketTransport("http://test", connect_timeout_s=5).send("POST", "/x", {}, bytes(99), 10)

    assert len(b"".join(connection.sent)) == HEAD + 99


def test_a_signal_leaves_no_connection_half_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C while an answer is awaited: the next request opens a connection of its own."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        transport = SocketTransport(
            f"http://127.0.0.1:{listener.getsockname()[1]}", connect_timeout_s=5
        )
        with monkeypatch.context() as signalled:
            signalled.setattr(AnswerParser, "__init__", Mock(side_effect=KeyboardInterrupt))
            with pytest.raises(KeyboardInterrupt):
                get(transport)
        with listener.accept()[0] as left:
            left.settimeout(10)
            read_head(left)
            assert left.recv(1) == b""  # closed

        thread = threading.Thread(target=get, args=(transport,))
        thread.start()
        with listener.accept()[0] as connection:
            answer(connection)
            thread.join(10)
            transport.close()
        assert not thread.is_alive()


def test_it_is_opened_again_only_once(serve: Serve) -> None:
    transport = serve(answer, lambda _: None)

    assert get(transport) == b"ok"
    with pytest.raises(ConnectionFailed):
        get(transport)


def test_a_server_that_hangs_times_out(serve: Serve) -> None:
    done = threading.Event()
    transport = serve(lambda _: done.wait(10) and None)

    with pytest.raises(TimedOut, match=r"within 0\.05 s"):
        get(transport, timeout_s=0.05)
    done.set()


def test_nobody_listening_is_a_failed_connection(reach: Reach) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]

    with pytest.raises(ConnectionFailed, match=str(port)):
        get(reach(port))


def test_an_answer_that_breaks_off_is_a_failed_connection(serve: Serve) -> None:
    def half(connection: socket.socket) -> None:
        read_head(connection)
        connection.sendall(OK[:-1])

    with pytest.raises(ConnectionFailed):
        get(serve(half))


def test_another_protocol_is_an_invalid_answer(serve: Serve) -> None:
    def greet(connection: socket.socket) -> None:
        read_head(connection)
        connection.sendall(b"SSH-2.0-OpenSSH_9.6\r\n\r\n")

    with pytest.raises(InvalidAnswer, match="does not speak HTTP"):
        get(serve(greet))


def test_a_refusal_is_heard_while_the_body_is_still_on_its_way(serve: Serve) -> None:
    """The service answers after the head and reads no further than the answer takes to arrive."""

    def refuse(connection: socket.socket) -> None:
        read_head(connection)
        connection.sendall(b"HTTP/1.1 413 Too Large\r\nContent-Length: 2\r\n\r\nno")
        connection.shutdown(socket.SHUT_WR)
        while connection.recv(65536):
            pass

    transport = serve(refuse)
    status, _, body = transport.send("POST", "/", {}, bytes(4 * 2**20), 10)
    transport.close()

    assert (status, body) == (413, b"no")


@pytest.mark.parametrize(
    "url", ["nonsense", "http://127.0.0.1:abc", "http://127.0.0.1:70000", "http://[::1"]
)
def test_a_url_of_no_service_is_named(url: str) -> None:
    with pytest.raises(ValueError, match="expected http://host") as caught:
        Address.of(url)
    assert f"got {url!r}" in str(caught.value)
