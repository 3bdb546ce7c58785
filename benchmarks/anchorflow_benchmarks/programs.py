"""Start servers and routers in processes of their own, beside a benchmark or a test."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from anchorflow_benchmarks import BenchmarkError

STOP_TIMEOUT_S = 30.0
CLI = "from anchorflow_cli.main import main; main()"
ROUTER = """
import sys, threading
from pathlib import Path
from anchorflow_client.zenoh_client import ZenohSettings
from anchorflow_client.zenoh_client.session import open_session
listen, *files = sys.argv[1:]
config_file = Path(files[0]) if files else None
session = open_session(ZenohSettings(mode="router", listen=(listen,), config_file=config_file))
print("up", flush=True)
threading.Event().wait()
"""


def free_port() -> int:
    """Return a port of this machine without a listener."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return listener.getsockname()[1]


def free_endpoint() -> str:
    """Return a zenoh endpoint on a free port of this machine."""
    return f"tcp/127.0.0.1:{free_port()}"


def serve_command(*options: object) -> list[str]:
    """Return the command of `anchorflow serve`, by default on a free port."""
    return [sys.executable, "-u", "-c", CLI, "serve", "--port", "0", *map(str, options)]


def router_command(endpoint: str, *config_file: Path) -> list[str]:
    """Return the command of a zenoh router that listens on an endpoint."""
    return [sys.executable, "-c", ROUTER, endpoint, *map(str, config_file)]


class Program:
    """A command that prints a line when it is up, and can be killed and started again.

    says: text in that line; by default the first line will do
    """

    def __init__(self, name: str, command: Sequence[str], *, says: str = "") -> None:
        self.name = name
        self.line = ""
        self._command = list(command)
        self._says = says
        self._process: subprocess.Popen[str] | None = None
        self._lock = threading.Lock()

    @property
    def url(self) -> str:
        """The address that a server prints when it is up."""
        return self.line.partition(" at ")[2].split()[0]

    def start(self) -> None:
        """Start the command unless it runs, and wait for the `line` that it prints when up.

        Raises `BenchmarkError` if it ends before.
        """
        with self._lock:
            if self._process is not None:
                return
            process = subprocess.Popen(self._command, stdout=subprocess.PIPE, text=True)
            self._process = process
            assert process.stdout is not None
            self.line = next((line for line in process.stdout if self._says in line), "")
        if not self.line:
            self.kill()
            raise BenchmarkError(f"{self.name} did not start: {' '.join(self._command)}")

    def signal(self, number: int) -> None:
        with self._lock:
            assert self._process is not None
            self._process.send_signal(number)

    def stop(self) -> None:
        """Send SIGTERM, and SIGKILL after STOP_TIMEOUT_S."""
        with self._lock:
            if self._process is not None:
                self._process.terminate()
                with suppress(subprocess.TimeoutExpired):
                    self._process.wait(STOP_TIMEOUT_S)
        self.kill()

    def kill(self) -> None:
        """Send SIGKILL."""
        with self._lock:
            if self._process is not None:
                self._process.kill()
                self._process.wait()
                assert self._process.stdout is not None
                self._process.stdout.close()
                self._process = None


@contextmanager
def running(program: Program) -> Iterator[Program]:
    """Start a program, and stop it at the end."""
    program.start()
    try:
        yield program
    finally:
        program.stop()


@contextmanager
def served(*options: str) -> Iterator[str]:
    """Run `anchorflow serve` with these options on a free port and yield its URL.

    Raises `BenchmarkError` if it did not start.
    """
    name = f"anchorflow serve {' '.join(options)}"
    with running(Program(name, serve_command(*options), says=" at ")) as program:
        yield program.url
