"""1,500 connections that send half a head, and go on opening new ones: a probe gets through."""

from __future__ import annotations

import socket
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

import pytest
from fastapi import FastAPI

resource = pytest.importorskip("resource", reason="sets the limit on open files")

CONNECTIONS = 1500
CHECKS = 10
PATIENCE_S = 5.0
"""Timeout of a probe; Kubernetes has 1 s."""
OPEN_FILES = 2 * CONNECTIONS + 1000
"""Both ends are in this process."""


@pytest.fixture
def many_files() -> Iterator[None]:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard != resource.RLIM_INFINITY and hard < OPEN_FILES:
        pytest.skip(f"ulimit -Hn: expected at least {OPEN_FILES} open files, got {hard}")
    raised = OPEN_FILES if soft != resource.RLIM_INFINITY and soft < OPEN_FILES else soft
    resource.setrlimit(resource.RLIMIT_NOFILE, (raised, hard))
    yield
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


class HalfHeads:
    """Keeps 1,500 connections open with half a head each, and reopens those that are closed."""

    def __init__(self, port: int) -> None:
        self._address = ("127.0.0.1", port)
        self._connections = [self._opened() for _ in range(CONNECTIONS)]
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._open_again)

    def __enter__(self) -> HalfHeads:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        for connection in self._connections:
            connection.close()

    def _open_again(self) -> None:
        while not self._stop.is_set():
            for place, connection in enumerate(self._connections):
                if is_open(connection):
                    continue
                connection.close()
                with suppress(OSError):  # it is tried again on the next round
                    self._connections[place] = self._opened()
                if self._stop.wait(0.001):
                    return

    def _opened(self) -> socket.socket:
        connection = socket.create_connection(self._address, timeout=PATIENCE_S)
        with suppress(ConnectionError):
            connection.sendall(b"GET /v2 HTTP/1.1\r\nHost: a\r\nX-Half: ")
        return connection


def is_open(connection: socket.socket) -> bool:
    """Whether the other side has not closed it."""
    try:
        return connection.recv(1, socket.MSG_DONTWAIT) != b""
    except BlockingIOError:
        return True
    except OSError:
        return False


def is_ready(url: str) -> bool:
    """One connection and no second try, as an orchestrator asks."""
    try:
        with urllib.request.urlopen(f"{url}/v2/health/ready", timeout=PATIENCE_S) as answer:
            return answer.status == 200
    except OSError:
        return False


@pytest.mark.usefixtures("many_files")
def test_a_probe_gets_through(app: FastAPI, serve: Callable[..., Any]) -> None:
    served = serve(app)
    answered: list[bool] = []
    took_ms: list[float] = []
    with HalfHeads(served.port):
        for _ in range(CHECKS):
            began = time.perf_counter()
            answered.append(is_ready(served.url))
            took_ms.append(round((time.perf_counter() - began) * 1e3, 1))

    assert answered == [True] * CHECKS, f"after {took_ms} ms"
