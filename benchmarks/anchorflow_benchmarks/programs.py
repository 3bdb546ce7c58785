"""Programs that run beside a benchmark, each in a process of its own: servers, a router."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass

from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_benchmarks.linux_processes import cpu_seconds

ENDS_S = 30.0
"""In which a program that is told to end has to."""
CLI = "from anchorflow_cli.main import main; main()"
ROUTER = """
import sys, threading
from anchorflow_client.zenoh_client import ZenohSettings
from anchorflow_client.zenoh_client.session import open_session
session = open_session(ZenohSettings(mode="router", listen=(sys.argv[1],)))
print("up", flush=True)
threading.Event().wait()
"""


def free_endpoint() -> str:
    """A zenoh endpoint of this machine where nobody listens yet."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return f"tcp/127.0.0.1:{listener.getsockname()[1]}"


def router_command(endpoint: str) -> list[str]:
    """A router that listens there."""
    return [sys.executable, "-c", ROUTER, endpoint]


def serve_command(*options: str) -> list[str]:
    """`anchorflow serve` on a free HTTP port, with these options."""
    return [sys.executable, "-u", "-c", CLI, "serve", "--port", "0", *options]


class Program:
    """A command that says on a line when it is up, and can be killed and started again.

    says: what stands in that line; the first one will do unless told
    """

    def __init__(
        self,
        name: str,
        command: Sequence[str],
        *,
        says: str = "",
        env: Mapping[str, str] | None = None,
    ) -> None:
        self.name = name
        self.line = ""
        self._command = list(command)
        self._says = says
        self._env = None if env is None else dict(env)
        self._process: subprocess.Popen[str] | None = None
        self._lock = threading.Lock()

    @property
    def pid(self) -> int:
        """Of its process; raises `BenchmarkError` where it does not run."""
        if self._process is None:
            raise BenchmarkError(f"{self.name} does not run")
        return self._process.pid

    def start(self) -> None:
        """Wait for the `line` that says that it is up; raises `BenchmarkError` where none does."""
        with self._lock:
            process = subprocess.Popen(
                self._command, stdout=subprocess.PIPE, text=True, env=self._env
            )
            self._process = process
            assert process.stdout is not None
            self.line = next((line for line in process.stdout if self._says in line), "")
        if not self.line:
            self.kill()
            raise BenchmarkError(f"{self.name} did not start: {' '.join(self._command)}")

    def signal(self, number: int) -> None:
        """Send it a signal."""
        with self._lock:
            assert self._process is not None
            self._process.send_signal(number)

    def stop(self) -> None:
        """SIGTERM, and SIGKILL where that does not end it."""
        with self._lock:
            if self._process is not None:
                self._process.terminate()
                with suppress(subprocess.TimeoutExpired):
                    self._process.wait(ENDS_S)
        self.kill()

    def kill(self) -> None:
        """SIGKILL: no farewell."""
        with self._lock:
            if self._process is not None:
                self._process.kill()
                self._process.wait()
                assert self._process.stdout is not None
                self._process.stdout.close()
                self._process = None


@contextmanager
def running(program: Program) -> Iterator[Program]:
    """Started, and stopped at the end."""
    program.start()
    try:
        yield program
    finally:
        program.stop()


@dataclass(frozen=True)
class Served:
    """A service: where it answers, and its process."""

    url: str
    pid: int

    @property
    def cpu_s(self) -> float:
        """Processor time that it has used; 0 where /proc does not tell."""
        return cpu_seconds(self.pid)


@contextmanager
def running_service(
    name: str, command: Sequence[str], *, env: Mapping[str, str] | None = None
) -> Iterator[Served]:
    """A program whose line says `NAMES at URL`.

    Raises:
        BenchmarkError: it did not start.
    """
    with running(Program(name, command, says=" at ", env=env)) as program:
        yield Served(program.line.partition(" at ")[2].split()[0], program.pid)


@contextmanager
def served(*options: str) -> Iterator[Served]:
    """`anchorflow serve` with these options, on a free port.

    Raises:
        BenchmarkError: it did not start.
    """
    with running_service(f"anchorflow serve {' '.join(options)}", serve_command(*options)) as found:
        yield found
