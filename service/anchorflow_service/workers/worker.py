"""The server of a worker: it says when it serves, and goes when its supervisor does."""

from __future__ import annotations

import json
import signal
import ssl
from contextlib import suppress
from multiprocessing.connection import Connection
from types import FrameType

from fastapi import FastAPI

from anchorflow_service.http.connections import ConnectionLimits
from anchorflow_service.http.lifecycle import AnchorServer, Draining
from anchorflow_service.planning import PlanningService
from anchorflow_service.workers.link import LEAVE, NOW, SERVES


class WorkerServer(AnchorServer):
    """An `AnchorServer` that listens to its supervisor as well.

    SIGTERM lets this worker alone go, however often it comes; Ctrl-C, which a terminal sends to
    every process, is the supervisor's to hear.

    Args:
        link: to the supervisor; where it breaks, the worker goes.
        models: the names and versions of what is served.
    """

    def __init__(
        self,
        app: FastAPI,
        service: PlanningService,
        *,
        link: Connection,
        models: str,
        limits: ConnectionLimits | None = None,
        draining: Draining | None = None,
        tls: ssl.SSLContext | None = None,
    ) -> None:
        super().__init__(
            app, service, limits=limits, draining=draining, tls=tls, say=self._say_to_supervisor
        )
        self._link = link
        self._is_alone = False
        self._models = models
        self._is_going = False

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """A signal: the first SIGTERM counts."""
        if sig == signal.SIGTERM and not self._is_going:
            self._is_going = True
            super().handle_exit(sig, frame)

    async def on_tick(self, counter: int) -> bool:
        """Hear the supervisor; whether it is time to go."""
        while not self._is_alone and self._link.poll():
            self._heed()
        return await super().on_tick(counter)

    def _say_to_supervisor(self) -> None:
        with suppress(OSError):  # one that has died is noticed on the next tick
            names = [card.name for card in self._service.engines.cards()]
            self._link.send_bytes(SERVES + json.dumps([self._models, *names]).encode())

    def _heed(self) -> None:
        try:
            word = self._link.recv_bytes()
        except (EOFError, OSError):  # the supervisor has died
            word, self._is_alone = LEAVE, True
        if word == LEAVE:
            self.handle_exit(signal.SIGTERM, None)
        elif word == NOW:
            super().handle_exit(signal.SIGTERM, None)
