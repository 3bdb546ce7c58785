"""The server's life: opened before it listens, and on SIGTERM out of sight before it stops."""

from __future__ import annotations

import asyncio
import math
import socket
import ssl
import time
from collections.abc import Callable
from contextlib import AsyncExitStack
from dataclasses import dataclass
from types import FrameType

import uvicorn
from fastapi import FastAPI

from anchorflow_service.http.connections import ConnectionLimits, limited
from anchorflow_service.planning import PlanningService

ACCEPTED_AT_A_TIME = 32
"""Connections that are accepted before those accepted before them are looked at again: so many more
files than the limit on connections are open at most, whatever crowd comes."""
QUEUED = 2048
"""Connections that the kernel keeps until they are accepted."""
CANCELLING_S = 1.0
"""For those whose requests are cancelled to be told so."""


@dataclass(frozen=True)
class Draining:
    """How a server goes."""

    notice_s: float = 0.0
    """Requests are still taken so long after readiness has turned false, for balancers to see."""
    drain_s: float = 10.0
    """Longest wait for requests that run; what then still runs is `not_ready`."""


class AnchorServer(uvicorn.Server):
    """uvicorn with the application opened by itself and with a notice before it goes.

    The application's lifespan is entered here and not by uvicorn, so that what fails in it is
    raised as it is. A second signal ends the notice at once.

    Args:
        say: called when it answers and heeds signals; whoever hears of it may stop it at once.
    """

    def __init__(
        self,
        app: FastAPI,
        service: PlanningService,
        *,
        limits: ConnectionLimits | None = None,
        draining: Draining | None = None,
        tls: ssl.SSLContext | None = None,
        say: Callable[[], None] = lambda: None,
    ) -> None:
        self._app = app
        self._service = service
        self._draining = draining or Draining()
        self._say = say
        self._opened = AsyncExitStack()
        self._leaving_since: float | None = None
        limits = limits or ConnectionLimits()
        super().__init__(
            uvicorn.Config(
                app,
                http=limited(limits, getattr(app.state, "exchange_listeners", ())),
                ws="none",
                lifespan="off",
                log_config=None,
                access_log=False,
                server_header=False,
                proxy_headers=False,
                backlog=ACCEPTED_AT_A_TIME,
                # What is cancelled by then is still answered.
                timeout_graceful_shutdown=math.ceil(self._draining.drain_s + CANCELLING_S),
                ssl_context_factory=None if tls is None else (lambda *_: tls),
            )
        )

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Open the application, then listen, then say so."""
        await self._opened.enter_async_context(self._app.router.lifespan_context(self._app))
        await super().startup(sockets)
        for listener in sockets or ():
            listener.listen(QUEUED)  # asyncio takes one number for the queue and for the tick
        self._say()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Listen no more, answer what came, close the application."""
        loop = asyncio.get_running_loop()
        loop.call_later(self._draining.drain_s, self._service.queue.cancel_all)
        await super().shutdown(sockets)
        await self._opened.aclose()

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """A signal: readiness turns false now, the rest follows after the notice."""
        self._service.leave()
        if self._leaving_since is None and self._draining.notice_s > 0:
            self._leaving_since = time.monotonic()
            self._captured_signals.append(sig)
        else:
            super().handle_exit(sig, frame)

    async def on_tick(self, counter: int) -> bool:
        """Whether it is time to go."""
        stopping = await super().on_tick(counter)
        since = self._leaving_since
        return stopping or (
            since is not None and time.monotonic() - since >= self._draining.notice_s
        )
