"""The transport on an event loop: one connection for each concurrent request."""

from __future__ import annotations

import asyncio
import http.client
from collections.abc import Mapping, Sequence
from typing import Any

from anchorflow_client.errors import UsageError
from anchorflow_client.http.answer_parser import AnswerParser, HttpAnswer
from anchorflow_client.http.transport import Address, translated, unreachable


class AsyncSocketTransport:
    """Keeps connections alive and reuses the one that was used last.

    If the service had closed an idle connection, a new one is opened, once. Cancelling the task
    that awaits an answer closes its connection, so that the service sees its client leave.
    """

    def __init__(self, url: str, *, connect_timeout_s: float, max_connections: int) -> None:
        """Check the arguments; `send` connects. Raises `UsageError`."""
        self._address = Address.of(url)
        if type(max_connections) is not int or max_connections < 1:
            raise UsageError(
                f"max_connections: expected a whole number of at least 1, got {max_connections!r}"
            )
        self._url = url
        self._connect_timeout_s = float(connect_timeout_s)
        self._slots = asyncio.Semaphore(max_connections)
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
        """Send a request and return its answer; `timeout_s` bounds each wait for more bytes."""
        head = self._address.head(method, path, headers, body)
        # CPython 3.12's `writelines` never finishes with an empty part.
        request = [head, body] if body else [head]
        times_closed = self._times_closed
        try:
            async with self._slots:
                return await self._exchange(request, timeout_s, times_closed)
        except (OSError, http.client.HTTPException) as error:
            raise translated(error, self._url, timeout_s=timeout_s) from error

    async def aclose(self) -> None:
        """Close all connections; pending requests fail, and a later `send` opens a new one."""
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
        while self._idle:
            connection = self._idle.pop()
            if connection.is_reusable:
                try:
                    return await self._send_on(connection, request, timeout_s)
                except ConnectionError:  # The service closed it while it was idle.
                    break
        if times_closed != self._times_closed:
            raise _closed()
        return await self._send_on(await self._connect(), request, timeout_s)

    async def _send_on(
        self, connection: _Connection, request: Sequence[bytes], timeout_s: float
    ) -> HttpAnswer:
        try:
            answer = await connection.send(request, timeout_s)
        except BaseException:  # cancellation too
            connection.abort()
            raise
        if connection.is_reusable:
            self._idle.append(connection)
        else:
            connection.abort()
        return answer

    async def _connect(self) -> _Connection:
        connection = _Connection(self._open)
        connecting = asyncio.ensure_future(
            asyncio.get_running_loop().create_connection(
                lambda: connection, self._address.host, self._address.port, ssl=self._address.tls
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


class _Connection(asyncio.Protocol):
    """One connection, which carries one request at a time; a member of `opened` while open."""

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
        """Return whether it is open and no byte of an earlier request or answer is pending."""
        transport = self._transport
        return (
            transport is not None
            and not transport.is_closing()
            and not transport.get_write_buffer_size()
            and self._parser.keeps_alive
        )

    async def send(self, request: Sequence[bytes], timeout_s: float) -> HttpAnswer:
        """Send a request and return its answer. Raises `OSError` or `HTTPException`."""
        if self._transport is None or self._transport.is_closing():
            raise _closed()
        self._parser, self._timeout_s = AnswerParser(), timeout_s
        self._answer = self._loop.create_future()
        try:
            self._transport.writelines(request)
            self._restart_timer()
            await self._answer
        finally:
            self._answer = None
            self._stop_timer()
        assert self._parser.answer is not None
        return self._parser.answer

    def abort(self) -> None:
        if self._transport is not None:
            self._transport.abort()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        transport.set_write_buffer_limits(high=0)  # so that `resume_writing` means: all is sent
        self._transport = transport
        self._opened.add(self)

    def resume_writing(self) -> None:
        self._restart_timer()

    def data_received(self, data: bytes) -> None:
        if self._answer is None:  # no request is pending
            self.abort()
            return
        self._restart_timer()
        try:
            self._parser.feed(data)
        except http.client.HTTPException as error:
            self._finish(error)
        else:
            if self._parser.answer is not None:
                self._finish()

    def eof_received(self) -> None:
        try:
            self._parser.end()
        except (OSError, http.client.HTTPException) as error:
            self._finish(error)
        else:
            self._finish()

    def connection_lost(self, exc: Exception | None) -> None:
        self._opened.discard(self)
        self._finish(exc or _closed())
        self.closed.set_result(None)

    def _finish(self, error: Exception | None = None) -> None:
        """Resolve the pending request, if there is one."""
        if self._answer is None or self._answer.done():
            return
        if error is None:
            self._answer.set_result(None)
        else:
            self._answer.set_exception(error)

    def _restart_timer(self) -> None:
        """Start the timeout anew, because bytes were received or all bytes were sent."""
        self._stop_timer()
        if self._answer is not None:
            self._timer = self._loop.call_later(self._timeout_s, self._finish, TimeoutError())

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


def _closed() -> ConnectionResetError:
    return ConnectionResetError("the connection was closed")
