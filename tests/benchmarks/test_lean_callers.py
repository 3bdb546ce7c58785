"""Callers that cost little, of servers over real sockets that follow a script."""

from __future__ import annotations

import socketserver
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler

import numpy as np
import pytest

from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.planners import request_of
from anchorflow_benchmarks.serving.lean_callers import lean_callers
from anchorflow_client import AnchorBatch, AnchorRequest
from anchorflow_client.codec import Payload
from anchorflow_client.contract import ModelId, OdeSpec
from anchorflow_client.errors import Overloaded, RequestError
from anchorflow_client.oip_codec import OipCodec
from anchorflow_trajectory.scene import Scene

MODEL = ModelId("stub", "1", "0")
ANSWER = OipCodec().encode_answer(
    AnchorBatch(
        arrays={"trajectories": np.zeros((2, 4, 2), np.float32)},
        dt=0.1,
        seed=0,
        model=MODEL,
        timing_ms={"total": 1.0},
    )
)
LENGTH = "Inference-Header-Content-Length"
LONG_S = 600.0


class Server(socketserver.ThreadingTCPServer):
    """Answers every question in pieces, but for those of which `refusal` makes an error.

    It is told how many have come.
    """

    daemon_threads = True
    allow_reuse_address = True

    def __init__(self, refusal: Callable[[int], Exception | None]) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.refusal = refusal
        self.asked: list[AnchorRequest] = []
        self.connections = 0
        self.lock = threading.Lock()


class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def setup(self) -> None:
        super().setup()
        with self._script.lock:
            self._script.connections += 1

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        asked = OipCodec().decode_request(Payload(body, int(self.headers[LENGTH])))
        with self._script.lock:
            self._script.asked.append(asked)
            count = len(self._script.asked)
        match error := self._script.refusal(count):
            case None:
                self._send(200, ANSWER.body, {LENGTH: str(ANSWER.header_length)})
            case Overloaded():
                said = b'{"error": {"code": "overloaded", "message": "full", "field": null}}'
                self._send(429, said, {"Retry-After": f"{error.retry_after_s:.0f}"})
            case _:
                self.close_connection = True

    def _send(self, status: int, body: bytes, headers: dict[str, str]) -> None:
        lines = [f"{name}: {value}\r\n" for name, value in headers.items()]
        head = f"HTTP/1.1 {status} X\r\n{''.join(lines)}Content-Length: {len(body)}\r\n\r\n"
        whole = head.encode() + body
        for start in range(0, len(whole), 50):
            self.wfile.write(whole[start : start + 50])

    @property
    def _script(self) -> Server:
        assert isinstance(self.server, Server)
        return self.server


@contextmanager
def serving(refusal: Callable[[int], Exception | None] = lambda _: None) -> Iterator[Server]:
    with Server(refusal) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()


def url_of(server: Server) -> str:
    return f"http://127.0.0.1:{server.server_address[1]}"


@pytest.fixture
def requests(scene: Callable[..., Scene]) -> list[AnchorRequest]:
    sampler = OdeSpec("euler", (0.0, 1.0))
    free = scene(np.zeros((64, 64), bool))
    return [request_of(free, num=num, seed=0, sampler=sampler) for num in (1, 2)]


def test_each_asks_again_over_its_connection_until_the_time_is_over(
    requests: list[AnchorRequest],
) -> None:
    with serving() as server:
        outcomes = lean_callers(url_of(server), requests, callers=3, seconds=0.3)

    assert server.connections == 3
    assert len(outcomes.ms) == len(server.asked) > 6
    assert outcomes.models == {MODEL: len(outcomes.ms)}
    assert {asked.num_samples for asked in server.asked} == {1, 2}
    assert outcomes.elapsed_s >= 0.3
    assert not outcomes.failed


def test_they_ask_at_the_same_time(requests: list[AnchorRequest]) -> None:
    """Nobody is answered before all three have asked."""
    together = threading.Barrier(3)

    def wait(count: int) -> None:
        if count <= 3:
            together.wait(30)

    with serving(wait) as server:
        outcomes = lean_callers(url_of(server), requests, callers=3, seconds=0.1)

    assert len(outcomes.ms) >= 3


def test_who_is_told_to_come_back_later_does(requests: list[AnchorRequest]) -> None:
    def refusal(count: int) -> RequestError | None:
        return Overloaded("full", retry_after_s=LONG_S) if count == 2 else None

    with serving(refusal) as server:
        outcomes = lean_callers(url_of(server), requests, callers=1, seconds=0.3)

    assert outcomes.errors == {"overloaded": 1}
    assert len(outcomes.ms) == 1
    assert 0.3 <= outcomes.elapsed_s < LONG_S


def test_who_is_cut_off_opens_another_connection(requests: list[AnchorRequest]) -> None:
    with serving(lambda count: OSError() if count % 2 else None) as server:
        outcomes = lean_callers(url_of(server), requests, callers=1, seconds=0.3)

    assert outcomes.errors["ConnectionFailed"] >= 1
    assert server.connections >= outcomes.errors["ConnectionFailed"]
    assert outcomes.ms


def test_only_this_machine_is_loaded(requests: list[AnchorRequest]) -> None:
    with pytest.raises(BenchmarkError, match="of this machine"):
        lean_callers("http://192.0.2.1:8000", requests, callers=1, seconds=0.1)
