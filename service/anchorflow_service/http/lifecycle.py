"""uvicorn's settings for this service, TLS, and a graceful exit: not ready before it stops."""

from __future__ import annotations

import asyncio
import math
import signal
import ssl
import threading
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing import parent_process
from pathlib import Path
from types import FrameType
from typing import Any

import uvicorn

from anchorflow_client.errors import AnchorFlowError
from anchorflow_service.http.connections import AnchorProtocol
from anchorflow_service.planning import PlanningService

BACKLOG = 128
"""Connections that the kernel queues, and that asyncio accepts at a time: as many files beyond the
limit on connections may be open for a moment."""
CANCELLING_S = 1.0
"""Time for requests that are cancelled at the end to be answered."""
WORKER_HEALTHCHECK_S = 20
"""Time for a worker to answer its supervisor, or it is replaced; importing takes seconds."""


class TlsError(AnchorFlowError):
    """A certificate, a key or an authority cannot be used."""


@dataclass(frozen=True)
class TlsFiles:
    """PEM files for TLS; none of them: plain HTTP."""

    certificate: Path | None = None
    """The server's certificate and its chain."""
    key: Path | None = None
    """Its private key, not encrypted."""
    client_ca: Path | None = None
    """Authorities; clients must present a certificate that one of them signed."""

    def context(self, *_: object) -> ssl.SSLContext:
        """Return the context of a server that speaks TLS 1.2 or later. Raises `TlsError`."""
        if self.certificate is None or self.key is None:
            raise TlsError("TLS needs --tls-cert and --tls-key, both of them")
        for path in filter(None, (self.certificate, self.key, self.client_ca)):
            _check_readable(path)
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        try:
            # OpenSSL would prompt for the password of an encrypted key at the terminal.
            context.load_cert_chain(self.certificate, self.key, password=_no_password)
        except ssl.SSLError as error:
            files = f"{self.certificate} with {self.key}"
            reason = error.reason or "not PEM"
            raise TlsError(f"{files}: no certificate and its key: {reason}") from error
        if self.client_ca is not None:
            try:
                context.load_verify_locations(self.client_ca)
            except ssl.SSLError as error:
                raise TlsError(f"{self.client_ca}: no PEM certificate of an authority") from error
            context.verify_mode = ssl.CERT_REQUIRED
        return context

    def __bool__(self) -> bool:
        return any((self.certificate, self.key, self.client_ca))


@dataclass(frozen=True)
class Draining:
    """How a service stops."""

    notice_s: float = 0.0
    """Time from readiness turning false to the closing of the port, for load balancers to see."""
    drain_s: float = 10.0
    """Longest wait for running requests; then they are answered `not_ready`."""


class GracefulExit:
    """Delays uvicorn's exit on a signal by the notice, and ends requests that outlast the drain.

    Entered in the application's lifespan, after uvicorn has installed its signal handlers. A second
    signal ends the notice, except in a worker, whose supervisor may repeat the first.
    """

    def __init__(self, service: PlanningService, draining: Draining) -> None:
        self._service = service
        self._draining = draining
        self.exit_handlers: dict[int, Callable[[int, FrameType | None], Any]] = {}
        """uvicorn's, by signal."""
        self._is_leaving = False

    async def __aenter__(self) -> GracefulExit:
        self._loop = asyncio.get_running_loop()
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                handler = signal.getsignal(number)
                if callable(handler):
                    self.exit_handlers[number] = handler
                    signal.signal(number, self.handle)
        return self

    async def __aexit__(self, *_: object) -> None:
        """Do nothing: uvicorn restores the handlers."""

    def handle(self, number: int, frame: FrameType | None = None) -> None:
        """Turn readiness false now, and exit after the notice."""
        self._service.leave()
        notice_s, is_first = self._draining.notice_s, not self._is_leaving
        self._is_leaving = True
        if is_first and notice_s > 0:
            self._later(notice_s, self._stop, number, frame)
        elif is_first or parent_process() is None:
            self._stop(number, frame)

    def _stop(self, number: int, frame: FrameType | None) -> None:
        self._later(self._draining.drain_s, self._service.queue.cancel_all)
        if number in self.exit_handlers:
            self.exit_handlers[number](number, frame)

    def _later(self, delay_s: float, call: Callable[..., object], *arguments: object) -> None:
        # A signal handler may interrupt the event loop anywhere.
        self._loop.call_soon_threadsafe(self._loop.call_later, delay_s, call, *arguments)


def uvicorn_config(
    app: Callable[..., Any],
    *,
    draining: Draining | None = None,
    tls: TlsFiles | None = None,
    workers: int = 1,
    factory: bool = False,
) -> uvicorn.Config:
    """Return uvicorn's settings; `create_app` makes the application, or `app` does as a factory."""
    drain_s = (draining or Draining()).drain_s
    return uvicorn.Config(
        app,
        http=AnchorProtocol,
        ws="none",
        lifespan="on",
        factory=factory,
        workers=workers,
        log_config=None,
        access_log=False,
        server_header=False,
        proxy_headers=False,
        backlog=BACKLOG,
        # Requests that are cancelled after the drain are still answered.
        timeout_graceful_shutdown=math.ceil(drain_s + CANCELLING_S),
        timeout_worker_healthcheck=WORKER_HEALTHCHECK_S,
        ssl_context_factory=tls.context if tls else None,
    )


def _no_password() -> str:
    raise TlsError("the private key is encrypted; expected one that is not")


def _check_readable(path: Path) -> None:
    try:
        with path.open("rb"):
            pass
    except OSError as error:
        raise TlsError(f"{path}: cannot be read: {error.strerror}") from error
