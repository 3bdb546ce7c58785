"""HTTP over sockets on an event loop, a connection for each request on its way."""

from __future__ import annotations

import asyncio
import http.client
import ssl
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

from anchorflow_client.http.answer_parser import AnswerParser
from anchorflow_client.http.transport import Address, HttpAnswer, translated, unreachable


class AsyncSocketTransport:
    """Connections that are kept alive, the one used last first.

    Where the service had closed an idle one, a new one is opened, once. Where the task that waits
    for an answer is cancelled, its connection is closed: the service sees its caller leave.
    """

    def __init__(self, url: str, *, connect_timeout_s: float, max_connections: int) -> None:
        """Opens nothing yet.

        Args:
            url: of the service.
            connect_timeout_s: longest wait for a connection.
            max_connections: requests on their way at the same time; others wait for a place.

        Raises:
            ValueError: `url` is no address of a service, or there is no place for any request.
        """
        self._address = Address.of(url)
        if type(max_connections) is not int or max_connections < 1:
            raise ValueError(
                f"max_connections: expected a whole number of at least 1, got {max_connections!r}"
            )
        self._url = url
        self._connect_timeout_s = float(connect_timeout_s)
        self._places = asyncio.Semaphore(max_connections)
        self._idle: list[_Connection] = []
        self._open: set[_Connection] = set()
        self._connecting: set[asyncio.Future[Any]] = set()
        self._times_closed = 0

    async def send(
        self,
        method: str,
        path: str,
        headers: Mapping[str, str],
        body: bytes | None,
        timeout_s: float,
    ) -> HttpAnswer:
        """Send and wait; `timeout_s` bounds each wait for the service's next bytes."""
        head = self._address.head(method, path, headers, body)
        # CPython 3.12's `writelines` is never done with an empty part.
        request = [head, body] if body else [head]
        times_closed = self._times_closed
        try:
            async with self._places:
                return await self._exchange(request, timeout_s, times_closed)
        except (OSError, http.client.HTTPException) as error:
            raise translated(error, self._url, timeout_s=timeout_s) from error

    async def aclose(self) -> None:
        """Close all connections; requests on their way fail, and a later `send` opens a new one."""
        self._times_closed += 1
        connections, connecting = list(self._open), list(self._connecting)
        for attempt in connecting:
            attempt.cancel()
        for connection in connections:
            connection.abort()
        await asyncio.gather(*connecting, return_exceptions=True)
        for connection in connections:
            await connection.closed

    async def _exchange(
        self, request: Sequence[bytes], timeout_s: float, times_closed: int
    ) -> HttpAnswer:
        if idle := self._take_idle():
            try:
                return await self._ask(idle, request, timeout_s)
            except ConnectionError:  # The service closed it while it was idle.
                pass
        if times_closed != self._times_closed:
            raise _closed()
        return await self._ask(await self._connect(), request, timeout_s)

    async def _ask(
        self, connection: _Connection, request: Sequence[bytes], timeout_s: float
    ) -> HttpAnswer:
        try:
            answer = await connection.ask(request, timeout_s)
        except BaseException:  # cancellation too
            connection.abort()
            raise
        if connection.is_reusable:
            self._idle.append(connection)
        else:
            connection.abort()
        return answer

    def _take_idle(self) -> _Connection | None:
        while self._idle:
            connection = self._idle.pop()
            if connection.is_reusable:
                return connection
        return None

    async def _connect(self) -> _Connection:
        connection = _Connection(self._open)
        connecting = asyncio.ensure_future(
            asyncio.get_running_loop().create_connection(
                lambda: connection, self._address.host, self._address.port, ssl=self._tls
            )
        )
        self._connecting.add(connecting)
        try:
            await asyncio.wait({connecting}, timeout=self._connect_timeout_s)
            if not connecting.done():
                raise TimeoutError
            if connecting.cancelled():  # by `aclose`
                raise _closed()
            connecting.result()
        except TimeoutError as error:  # ours, or the kernel's
            raise unreachable(self._url, timeout_s=self._connect_timeout_s) from error
        except asyncio.CancelledError:
            connection.abort()
            raise
        finally:
            connecting.cancel()
            self._connecting.discard(connecting)
        return connection

    @cached_property
    def _tls(self) -> ssl.SSLContext | None:
        return self._address.tls()


class _Connection(asyncio.Protocol):
    """One connection, which carries one request at a time; it is in `opened` while it is open."""

    def __init__(self, opened: set[_Connection]) -> None:
        self._opened = opened
        self._loop = asyncio.get_running_loop()
        self.closed: asyncio.Future[None] = self._loop.create_future()
        self._transport: asyncio.Transport | None = None
        self._parser = AnswerParser()
        self._answer: asyncio.Future[None] | None = None
        self._timeout_s = 0.0
        self._timer: asyncio.TimerHandle | None = None

    @property
    def is_reusable(self) -> bool:
        """Whether the service keeps it open, and nothing of an earlier request is on its way."""
        transport = self._transport
        return (
            transport is not None
            and not transport.is_closing()
            and not transport.get_write_buffer_size()
            and self._parser.keeps_alive
        )

    async def ask(self, request: Sequence[bytes], timeout_s: float) -> HttpAnswer:
        """The answer.

        Raises:
            OSError: the connection broke, or nothing was heard for so long.
            HTTPException: what came is not HTTP's.
        """
        if self._transport is None or self._transport.is_closing():
            raise _closed()
        self._parser, self._timeout_s = AnswerParser(), timeout_s
        self._answer = self._loop.create_future()
        try:
            self._transport.writelines(request)
            self._wait_on()
            await self._answer
        finally:
            self._answer = None
            self._stop_waiting()
        assert self._parser.answer is not None
        return self._parser.answer

    def abort(self) -> None:
        """Close it at once."""
        if self._transport is not None:
            self._transport.abort()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        transport.set_write_buffer_limits(high=0)  # so that `resume_writing` says: all is sent
        self._transport = transport
        self._opened.add(self)

    def resume_writing(self) -> None:
        self._wait_on()

    def data_received(self, data: bytes) -> None:
        if self._answer is None:  # nobody asked
            self.abort()
            return
        self._wait_on()
        try:
            self._parser.feed(data)
        except http.client.HTTPException as error:
            self._settle(error)
        else:
            if self._parser.answer is not None:
                self._settle()

    def eof_received(self) -> None:
        try:
            self._parser.end()
        except (OSError, http.client.HTTPException) as error:
            self._settle(error)
        else:
            self._settle()

    def connection_lost(self, exc: Exception | None) -> None:
        self._opened.discard(self)
        self._settle(exc or _closed())
        self.closed.set_result(None)

    def _settle(self, error: Exception | None = None) -> None:
        """Ends the wait for the answer, where it goes on."""
        if self._answer is None or self._answer.done():
            return
        if error is None:
            self._answer.set_result(None)
        else:
            self._answer.set_exception(error)

    def _wait_on(self) -> None:
        """The service was heard, or has heard: it has so long from now."""
        self._stop_waiting()
        if self._answer is not None:
            self._timer = self._loop.call_later(self._timeout_s, self._settle, TimeoutError())

    def _stop_waiting(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


def _closed() -> ConnectionResetError:
    return ConnectionResetError("the connection was closed")
