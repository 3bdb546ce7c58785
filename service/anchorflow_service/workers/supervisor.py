"""Starts workers, replaces those that die, and lets all of them go."""

from __future__ import annotations

import logging
import os
import signal
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection, wait

from anchorflow_client.errors import AnchorFlowError
from anchorflow_service.workers.link import LEAVE, NOW
from anchorflow_service.workers.process import Entry, WorkerProcess

SIGNALS = (signal.SIGTERM, signal.SIGINT)
FIRST_PAUSE_S, LONGEST_PAUSE_S = 1.0, 30.0
"""Before a worker that could not start is tried again, while others serve."""
LONGEST_WAIT_S = 3600.0
"""At a time: the system counts milliseconds in 31 bits."""

logger = logging.getLogger(__name__)


class WorkerError(AnchorFlowError):
    """A worker cannot start; the message is its own."""


class Supervisor:
    """Keeps so many workers on one listening socket.

    Connections wait in the socket's one queue, so none of those is lost where a worker is.

    Args:
        entry: runs in each worker's process.
        listener: closed here when the workers are told to go, so that the port closes with them.
        count: of workers.
        leave_s: longest wait for workers that were told to go; then they are killed.
    """

    def __init__(
        self, entry: Entry, listener: socket.socket, *, count: int, leave_s: float
    ) -> None:
        self._entry = entry
        self._listener = listener
        self._count = count
        self._leave_s = leave_s
        self._workers: list[WorkerProcess] = []
        self._all_have_served = False
        self._names: tuple[str, ...] = ()
        """Of the models that the first ones serve."""
        self._pause_s = FIRST_PAUSE_S
        self._not_before = 0.0

    def run(self, on_serving: Callable[[str], None]) -> int:
        """Supervise until SIGTERM or SIGINT comes, and give its number.

        on_serving: told the models once all workers serve, at the start

        Raises:
            WorkerError: a worker cannot start, at the start or when no other serves.
        """
        with _signals() as told:
            try:
                while not (came := self._signal(told)):
                    self._start_missing()
                    self._hear(told)
                    self._tell_of_start(on_serving)
            except WorkerError:
                self._let_go(told, hurry=True)
                raise
            self._let_go(told, hurry=False)
        return came

    def _start_missing(self) -> None:
        if time.monotonic() >= self._not_before:
            for _ in range(self._count - len(self._workers)):
                self._workers.append(WorkerProcess(self._entry, self._listener, self._names))

    def _hear(self, told: int) -> None:
        """Wait until a worker says something or ends, a signal comes, or a worker may be tried."""
        short = len(self._workers) < self._count
        timeout_s = max(0.0, self._not_before - time.monotonic()) if short else None
        for worker in self._readable(told, timeout_s):
            if worker.hear():
                continue
            self._workers.remove(worker)
            if worker.serves:
                logger.warning("%s; another takes its place", worker.end)
            else:
                self._could_not_start(worker)

    def _could_not_start(self, worker: WorkerProcess) -> None:
        if not (self._all_have_served and any(each.serves for each in self._workers)):
            raise WorkerError(worker.end)
        logger.error("no worker can be started, next try in %g s: %s", self._pause_s, worker.end)
        self._not_before = time.monotonic() + self._pause_s
        self._pause_s = min(2.0 * self._pause_s, LONGEST_PAUSE_S)

    def _tell_of_start(self, on_serving: Callable[[str], None]) -> None:
        models = [each.models for each in self._workers if each.models is not None]
        if len(models) < self._count:
            return
        self._pause_s = FIRST_PAUSE_S
        if not self._all_have_served:
            self._names, *others = (each.names for each in self._workers)
            if others != [self._names] * len(others):
                raise WorkerError("expected the same models of all workers; is one being copied?")
            self._all_have_served = True
            on_serving(models[0])

    def _let_go(self, told: int, *, hurry: bool) -> None:
        """Tell the workers to go and wait for them; a further signal ends their notice."""
        self._listener.close()
        for worker in self._workers:
            if worker.serves:
                worker.tell(LEAVE)
            else:
                worker.terminate()
        until = time.monotonic() + self._leave_s
        while self._workers:
            if hurry or self._signal(told):
                for worker in self._workers:
                    worker.tell(NOW)
                hurry = False
            left_s = until - time.monotonic()
            if left_s <= 0.0:
                self._kill_the_rest()
                return
            for worker in self._readable(told, left_s):
                if not worker.hear():
                    self._workers.remove(worker)

    def _kill_the_rest(self) -> None:
        for worker in self._workers:
            logger.error("worker %d is killed: it did not end in %g s", worker.pid, self._leave_s)
            worker.kill()

    def _readable(self, told: int, timeout_s: float | None) -> list[WorkerProcess]:
        """The workers that have said something or ended; none where a signal came instead."""
        links: dict[int | Connection, WorkerProcess] = {each.link: each for each in self._workers}
        most_s = None if timeout_s is None else min(timeout_s, LONGEST_WAIT_S)
        ready = wait([told, *links], most_s)
        return [worker for link, worker in links.items() if link in ready]

    def _signal(self, told: int) -> int:
        """The last signal that came since; 0 where none did."""
        return os.read(told, 64)[-1] if wait([told], 0) else 0


@contextmanager
def _signals() -> Iterator[int]:
    """A descriptor from which signals can be read, a byte each, while the block lasts."""
    told, tell = os.pipe()
    os.set_blocking(tell, False)
    before = {
        each: signal.signal(each, lambda number, _: os.write(tell, bytes([number])))
        for each in SIGNALS
    }
    try:
        yield told
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
        os.close(told)
        os.close(tell)
