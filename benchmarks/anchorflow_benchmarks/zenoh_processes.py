"""A router and replicas, each in a process of its own, on a port of this machine."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from anchorflow_benchmarks.errors import BenchmarkError

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


def serve_command(bundle: Path, *zenoh: str) -> list[str]:
    """`anchorflow serve` of a bundle on a free HTTP port, with these zenoh options."""
    serve = ("serve", "--port", "0", "--bundle", str(bundle))
    return [sys.executable, "-u", "-c", CLI, *serve, *zenoh]


class Process:
    """A program that says on a line of its own that it is up, and can be killed and come back."""

    def __init__(self, name: str, command: Sequence[str]) -> None:
        self.name = name
        self._command = list(command)
        self._process: subprocess.Popen[str] | None = None
        self._lock = threading.Lock()

    def start(self) -> str:
        """Gives the first line. Raises `BenchmarkError` where none comes."""
        with self._lock:
            self._process = subprocess.Popen(self._command, stdout=subprocess.PIPE, text=True)
            assert self._process.stdout is not None
            line = self._process.stdout.readline()
        if not line:
            raise BenchmarkError(f"{self.name} did not start: {' '.join(self._command)}")
        return line

    def signal(self, number: int) -> None:
        """Send it a signal."""
        with self._lock:
            assert self._process is not None
            self._process.send_signal(number)

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
def running(process: Process) -> Iterator[Process]:
    """Started, and killed at the end."""
    process.start()
    try:
        yield process
    finally:
        process.kill()
