"""Closed-loop callers of an HTTP server that leave the cores to it.

Their requests are encoded ahead, one event loop waits for all of them, and of an answer no more is
read than its status, its model and, where it is a refusal, its words.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle, islice
from time import perf_counter
from urllib.parse import urlsplit

from anchorflow_benchmarks.clients import TIMEOUT_S, Outcomes, check_loopback
from anchorflow_client.codec import Payload
from anchorflow_client.contract import AnchorRequest, ModelId
from anchorflow_client.errors import AnchorFlowError, ConnectionFailed, Overloaded
from anchorflow_client.http.exchange import Exchange, Exchanges
from anchorflow_client.http.transport import HttpAnswer
from anchorflow_client.oip.message import unpack_header
from anchorflow_client.oip_codec import OipCodec

BLANK_LINE = b"\r\n\r\n"
HEARD_BYTES = 2**18
"""At a time."""


def lean_callers(
    url: str, requests: Sequence[AnchorRequest], *, callers: int, seconds: float
) -> Outcomes:
    """What becomes of the questions of so many callers, each of whom asks again when answered.

    One who is told to come back later waits for so long. Nobody asks after `seconds`; what was
    asked by then is still waited for.

    Raises:
        BenchmarkError: the URL names another machine.
    """
    check_loopback(url)
    questions = [_Question.of(request, url) for request in requests]
    outcomes = Outcomes()

    async def all_ask() -> None:
        start = perf_counter()
        until = start + seconds
        await asyncio.gather(
            *(_ask_on(url, questions, first, until, outcomes) for first in range(callers))
        )
        outcomes.elapsed_s = perf_counter() - start

    asyncio.run(all_ask())
    return outcomes


@dataclass(frozen=True)
class _Question:
    """A request as it is sent, head and all, and the way to read who answered."""

    sent: bytes
    exchange: Exchange[ModelId]

    @classmethod
    def of(cls, request: AnchorRequest, url: str) -> _Question:
        plan = Exchanges(url, codec=OipCodec(), token=None).plan(request)
        body = plan.body or b""
        told = {"Host": urlsplit(url).netloc, "Content-Length": len(body), **plan.headers}
        lines = [f"{plan.method} {plan.path} HTTP/1.1", *(f"{k}: {v}" for k, v in told.items())]
        exchange = Exchange(plan.method, plan.path, plan.headers, plan.body, _model_of)
        return cls("\r\n".join(lines).encode() + BLANK_LINE + body, exchange)


def _model_of(answer: Payload) -> ModelId:
    header, _ = unpack_header(answer)
    sha256 = header["parameters"]["model.sha256"]
    return ModelId(header["model_name"], header["model_version"], sha256)


async def _ask_on(
    url: str, questions: Sequence[_Question], first: int, until: float, outcomes: Outcomes
) -> None:
    """Ask one question after the other, beginning with the `first`."""
    connection = _connected(url)
    try:
        for question in islice(cycle(questions), first % len(questions), None):
            start = perf_counter()
            if start >= until:
                return
            try:
                answer = await asyncio.wait_for(_answer(connection, question.sent), TIMEOUT_S)
                model = question.exchange.result(answer)
            except Overloaded as error:
                outcomes.errors[error.code] += 1
                rest_s = min(error.retry_after_s or 0.0, until - perf_counter())
                await asyncio.sleep(max(0.0, rest_s))
            except AnchorFlowError as error:
                outcomes.errors[getattr(error, "code", type(error).__name__)] += 1
            except (OSError, asyncio.TimeoutError):
                outcomes.errors[ConnectionFailed.__name__] += 1
                connection.close()
                connection = _connected(url)
            else:
                outcomes.ms.append((perf_counter() - start) * 1e3)
                outcomes.models[model] += 1
    finally:
        connection.close()


def _connected(url: str) -> socket.socket:
    parts = urlsplit(url)
    connection = socket.create_connection((parts.hostname or "", parts.port or 80))
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    connection.setblocking(False)
    return connection


async def _answer(connection: socket.socket, question: bytes) -> HttpAnswer:
    """The answer to a question, cut by its length. Raises `OSError` where it does not come."""
    loop = asyncio.get_running_loop()
    await loop.sock_sendall(connection, question)
    heard = bytearray()
    while BLANK_LINE not in heard:
        heard += await _heard(connection)
    head, _, body = heard.partition(BLANK_LINE)
    status, *lines = head.decode("latin-1").split("\r\n")
    headers = {name.lower(): value for name, _, value in (each.partition(": ") for each in lines)}
    while len(body) < int(headers["content-length"]):
        body += await _heard(connection)
    return int(status.split()[1]), headers, bytes(body)


async def _heard(connection: socket.socket) -> bytes:
    data = await asyncio.get_running_loop().sock_recv(connection, HEARD_BYTES)
    if not data:
        raise ConnectionResetError("the connection was closed without a whole answer")
    return data
