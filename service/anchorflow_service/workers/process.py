"""A worker as its supervisor sees it."""

from __future__ import annotations

import json
import signal
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection

from anchorflow_service.workers.link import FAILED, SERVES

Entry = Callable[[socket.socket, Connection, tuple[str, ...]], None]
"""What runs in a worker's process: serves on the socket, speaks with the supervisor, and has at
least the models of those names, the first of them as default."""

REAPING_S = 5.0
"""For a process to be gone once its pipe is closed; then it is killed."""


class WorkerProcess:
    """A process of its own, from its start to its end.

    Spawned, not forked: threads of onnxruntime and locks of the supervisor's do not survive a fork.
    """

    def __init__(self, entry: Entry, listener: socket.socket, names: tuple[str, ...]) -> None:
        """Starts it.

        entry: found again by its name in the new process; what is bound to it is sent there
        """
        context = get_context("spawn")
        self.link, theirs = context.Pipe()
        # Daemonic: should the supervisor fail, it ends its workers and does not wait for them.
        self._process = context.Process(target=entry, args=(listener, theirs, names), daemon=True)
        with _without_interrupts():
            self._process.start()
        theirs.close()
        self.models: str | None = None
        """What it serves, with versions; None before it does."""
        self.names: tuple[str, ...] = ()
        """Of those models."""
        self._fault: str | None = None

    @property
    def pid(self) -> int:
        """Of the process."""
        assert self._process.pid is not None
        return self._process.pid

    @property
    def serves(self) -> bool:
        """Whether it has taken requests at any time."""
        return self.models is not None

    @property
    def end(self) -> str:
        """Why it ended, in its own words or by its status."""
        code = self._process.exitcode or 0
        by = f"signal {signal.Signals(-code).name}" if code < 0 else f"status {code}"
        return self._fault or f"worker {self.pid} ended with {by}"

    def hear(self) -> bool:
        """Take in one thing that it said, once `link` is readable; False where it has ended."""
        try:
            said = self.link.recv_bytes()
        except (EOFError, OSError):  # a process that was killed may reset the pipe
            self._reap()
            return False
        if said.startswith(SERVES):
            self.models, *names = json.loads(said.removeprefix(SERVES))
            self.names = tuple(names)
        elif said.startswith(FAILED):
            self._fault = said.removeprefix(FAILED).decode()
        return True

    def tell(self, word: bytes) -> None:
        """Say it to the worker, if that is still there."""
        with suppress(OSError):
            self.link.send_bytes(word)

    def terminate(self) -> None:
        """SIGTERM."""
        self._process.terminate()

    def kill(self) -> None:
        """SIGKILL."""
        self._process.kill()
        self._reap()

    def _reap(self) -> None:
        self._process.join(REAPING_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self.link.close()


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """A process that begins here ignores Ctrl-C until it says otherwise."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
