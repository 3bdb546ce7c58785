"""The socket transports, blocking and async, against servers with one fault each."""

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
from anchorflow_client.http.transport import Address, SocketTransport, _send_all

OK = b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\nX-Kind: test\r\n\r\nok"
Script = Callable[[socket.socket], None]
Reach = Callable[[int], Any]
Serve = Callable[..., Any]


def read_head(connection: socket.socket) -> bytes:
    head = b""
    while b"\r\n\r\n" not in head:
        head += connection.recv(65536)
    return head


def answer(connection: socket.socket) -> None:
    """Answer once, and leave the connection open."""
    read_head(connection)
    connection.sendall(OK)


@pytest.fixture(params=["blocking", "async"])
def reach(request: pytest.FixtureRequest, blocking: Callable[[Any], Any]) -> Reach:
    """Makes either transport, connected to a local port."""

    def make(port: int) -> Any:
        url = f"http://127.0.0.1:{port}"
        if request.param == "blocking":
            return SocketTransport(url, connect_timeout_s=5)
        return blocking(AsyncSocketTransport(url, connect_timeout_s=5, max_connections=2))

    return make


@pytest.fixture
def serve(reach: Reach) -> Iterator[Serve]:
    """Accepts one connection for each script, and closes it after the script."""
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


def answer_once(connection: socket.socket) -> None:
    answer(connection)
    read_head(connection)  # the next request arrives, and the connection closes


def answer_twice(connection: socket.socket) -> None:
    answer(connection)
    answer(connection)


@pytest.mark.parametrize("scripts", [(answer_twice,), (answer, answer), (answer_once, answer)])
def test_the_connection_is_kept_and_reopened_if_it_was_closed(
    serve: Serve, scripts: Sequence[Script]
) -> None:
    transport = serve(*scripts)
    for _ in range(2):
        status, headers, body = transport.send("POST", "/x", {}, b"body", 10)
        assert (status, headers["x-kind"], body) == (200, "test", b"ok")


@pytest.fixture
def secured(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[Script], SocketTransport]]:
    """Makes a transport to a TLS server that runs the script on two connections."""
    authority = trustme.CA()
    ours, theirs = ssl.create_default_context(), ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    authority.configure_trust(ours)
    authority.issue_cert("localhost").configure_cert(theirs)
    monkeypatch.setattr(Address, "tls", ours)
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
            stack.callback(listener.shutdown, socket.SHUT_RDWR)  # ends accept()
            url = f"https://localhost:{listener.getsockname()[1]}"
            transport = SocketTransport(url, connect_timeout_s=5)
            stack.callback(transport.close)
            return transport

        yield start


BODY = bytes(2**18)
"""A body of several TLS records, so that sending fails if the server has left."""


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


def test_a_refusal_under_tls_is_read_if_the_body_is_not_received(
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
            while head := connection.recv(65536):  # each head is one packet
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


def test_a_lock_that_was_held_at_a_fork_blocks_no_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        url = f"http://127.0.0.1:{listener.getsockname()[1]}"
        transport = SocketTransport(url, connect_timeout_s=5)
        with transport._turn():  # another thread's, which is not in the child
            monkeypatch.setattr(os, "getpid", lambda: -1)
            thread = threading.Thread(target=transport.close, daemon=True)
            thread.start()
            thread.join(10)
            assert not thread.is_alive()


class PartialSocket:
    """A socket that accepts some bytes of the first call, and all of later ones."""

    def __init__(self, accepts: int) -> None:
        self.sent: list[bytes] = []
        self._accepts = accepts

    def sendmsg(self, parts: Sequence[bytes]) -> int:
        self.sent.append(b"".join(parts)[: self._accepts])
        return len(self.sent[-1])

    def sendall(self, data: bytes) -> None:
        self.sent.append(bytes(data))


@pytest.mark.parametrize(
    ("accepts", "calls"), [(10**6, 1), (0, 3), (10, 3), (len(OK), 2), (len(OK) + 9, 2), (None, 1)]
)
def test_a_head_and_its_body_are_sent_with_as_few_calls_as_possible(
    accepts: int | None, calls: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    connection: Any = PartialSocket(accepts or 0)
    if accepts is None:  # as on Windows, and under TLS
        monkeypatch.delattr(PartialSocket, "sendmsg")

    _send_all(connection, OK, bytes(99))

    assert b"".join(connection.sent) == OK + bytes(99)
    assert len(connection.sent) == calls


def test_a_signal_leaves_no_connection_half_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """The request after a Ctrl-C opens a new connection."""
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


def test_it_is_reopened_only_once(serve: Serve) -> None:
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


def test_no_listener_is_a_failed_connection(reach: Reach) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]

    with pytest.raises(ConnectionFailed, match=str(port)):
        get(reach(port))


@pytest.mark.parametrize(
    ("data", "error", "words"),
    [
        (OK[:-1], ConnectionFailed, "IncompleteRead"),
        (b"SSH-2.0-OpenSSH_9.6\r\n\r\n", InvalidAnswer, "does not speak HTTP"),
    ],
)
def test_an_incomplete_answer_and_another_protocol(
    serve: Serve, data: bytes, error: type[Exception], words: str
) -> None:
    def send(connection: socket.socket) -> None:
        read_head(connection)
        connection.sendall(data)

    with pytest.raises(error, match=words):
        get(serve(send))


def test_a_refusal_is_read_while_the_body_is_being_sent(serve: Serve) -> None:
    """The service answers after the head, and reads the body only until the answer has arrived."""

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
