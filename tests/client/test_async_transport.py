"""The async transport with concurrent requests, which the blocking one does not have."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager, suppress
from typing import Any

import pytest

from anchorflow_client import ConnectionFailed, TimedOut
from anchorflow_client.http.async_transport import AsyncSocketTransport, _Connection
from anchorflow_client.http.transport import HttpAnswer

pytestmark = pytest.mark.anyio

OK = b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\nok"


class Server:
    """Answers requests once the test allows it, and counts connections."""

    def __init__(self) -> None:
        self.asked = asyncio.Semaphore(0)
        self.heads: list[bytes] = []
        self.may_answer = asyncio.Event()
        self.hung_up = asyncio.Event()
        self.connections = 0
        self.handlers: list[asyncio.Task[None] | None] = []

    async def __call__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections += 1
        self.handlers.append(asyncio.current_task())
        try:
            while True:
                self.heads.append(await reader.readuntil(b"\r\n\r\n"))
                self.asked.release()
                gone = asyncio.ensure_future(reader.read(1))
                may = asyncio.ensure_future(self.may_answer.wait())
                await asyncio.wait({gone, may}, return_when=asyncio.FIRST_COMPLETED)
                if gone.done():
                    may.cancel()
                    break
                gone.cancel()
                await asyncio.wait({gone})
                writer.write(OK)
        except (asyncio.IncompleteReadError, ConnectionError):
            pass
        self.hung_up.set()
        writer.close()
        with suppress(ConnectionError):
            await writer.wait_closed()


@asynccontextmanager
async def serving(max_connections: int = 8) -> AsyncIterator[tuple[Server, AsyncSocketTransport]]:
    server = Server()
    listening = await asyncio.start_server(server, "127.0.0.1", 0)
    port = listening.sockets[0].getsockname()[1]
    url = f"http://127.0.0.1:{port}"
    transport = AsyncSocketTransport(url, connect_timeout_s=5, max_connections=max_connections)
    yield server, transport
    await transport.aclose()
    listening.close()
    await listening.wait_closed()
    await asyncio.gather(*filter(None, server.handlers))


async def get(transport: AsyncSocketTransport, timeout_s: float = 20) -> bytes:
    return (await transport.send("GET", "/", {}, None, timeout_s))[2]


@pytest.mark.parametrize("max_connections", [8, 2])
async def test_each_request_has_a_kept_connection_up_to_the_limit(max_connections: int) -> None:
    expected = min(max_connections, 4)

    async with serving(max_connections) as (server, transport):
        pending = asyncio.gather(*(get(transport) for _ in range(4)))
        for _ in range(expected):
            await server.asked.acquire()
        server.may_answer.set()
        assert await pending == [b"ok"] * 4
        assert await asyncio.gather(*(get(transport) for _ in range(4))) == [b"ok"] * 4
        assert server.connections == expected


async def test_a_cancelled_request_frees_its_slot() -> None:
    async with serving(max_connections=1) as (server, transport):
        first = asyncio.ensure_future(get(transport))
        await server.asked.acquire()
        second = asyncio.ensure_future(get(transport))
        first.cancel()
        await server.asked.acquire()
        server.may_answer.set()
        assert await second == b"ok"
        assert first.cancelled()
        assert server.hung_up.is_set()


async def test_a_request_that_times_out_frees_its_slot() -> None:
    async with serving(max_connections=1) as (server, transport):
        with pytest.raises(TimedOut, match=r"within 0\.05 s"):
            await get(transport, timeout_s=0.05)
        server.may_answer.set()
        assert await get(transport) == b"ok"


async def test_a_head_is_that_of_the_blocking_client() -> None:
    async with serving() as (server, transport):
        server.may_answer.set()
        await transport.send("POST", "/a", {"X-Kind": "test"}, b"", 20)
        first, *rest = server.heads[0].decode().rstrip().split("\r\n")
        assert first == "POST /a HTTP/1.1"
        headers = dict(line.split(": ", 1) for line in rest)
        assert headers.pop("Host").startswith("127.0.0.1:")
        assert headers == {
            "Accept-Encoding": "identity",
            "Content-Length": "0",
            "X-Kind": "test",
        }


async def test_no_empty_part_reaches_the_event_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    """CPython 3.12's `writelines` never finishes with one: the loop would spin."""
    send, requests = _Connection.send, list[Sequence[bytes]]()

    async def asked(self: _Connection, request: Sequence[bytes], timeout_s: float) -> HttpAnswer:
        requests.append(request)
        return await send(self, request, timeout_s)

    monkeypatch.setattr(_Connection, "send", asked)
    async with serving() as (server, transport):
        server.may_answer.set()
        await get(transport)
        await transport.send("POST", "/", {}, b"", 20)

    assert len(requests) == 2
    assert all(part for request in requests for part in request)


@pytest.mark.parametrize("turns", range(1, 12))
async def test_pending_requests_fail_at_close(turns: int) -> None:
    """The close happens before a connection is open, while it is opened, or later."""

    async with serving(max_connections=1) as (server, transport):
        pending = [asyncio.ensure_future(get(transport)) for _ in range(2)]
        for _ in range(turns):
            await asyncio.sleep(0)
        await transport.aclose()
        assert not transport._open
        server.may_answer.set()
        for each in pending:
            with pytest.raises(ConnectionFailed, match="closed"):
                await each
        assert await get(transport) == b"ok"


async def test_a_header_cannot_end_its_line() -> None:
    async with serving() as (server, transport):
        with pytest.raises(ValueError, match=r"^Authorization: expected printable ASCII"):
            await transport.send("GET", "/", {"Authorization": "Bearer a\r\nX: y"}, None, 20)
        assert server.connections == 0


async def test_a_connection_with_unsent_bytes_is_not_kept() -> None:
    """The service would read the rest of the body as the head of the next request."""

    heard, hung_up = asyncio.Event(), asyncio.Event()

    async def refuse(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"\r\n\r\n")
        writer.write(b"HTTP/1.1 413 Too Large\r\nContent-Length: 2\r\n\r\nno")
        await heard.wait()
        with suppress(ConnectionError):
            while not reader.at_eof():
                await reader.read(2**16)
        writer.close()
        hung_up.set()

    async with await asyncio.start_server(refuse, "127.0.0.1", 0) as listening:
        url = f"http://127.0.0.1:{listening.sockets[0].getsockname()[1]}"
        transport = AsyncSocketTransport(url, connect_timeout_s=5, max_connections=1)
        status, _, body = await transport.send("POST", "/", {}, bytes(2**24), 20)
        assert (status, body) == (413, b"no")
        heard.set()
        await hung_up.wait()
        await transport.aclose()


@pytest.mark.parametrize("count", [0, 1.5, "8", True])
def test_at_least_one_place_is_needed(count: Any) -> None:
    expected = f"max_connections: expected a whole number of at least 1, got {count!r}"
    with pytest.raises(ValueError, match=re.escape(expected)):
        AsyncSocketTransport("http://robot", connect_timeout_s=5, max_connections=count)
