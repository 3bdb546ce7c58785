"""Type commands in a folder, in a network namespace where every port of a page is free."""

from __future__ import annotations

import os
import re
import select
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

# Commands that run until Ctrl-C, and what they print when they are up.
SERVERS = {
    r"(\S+/bin/)?anchorflow serve\b": r" at https?://",
    r"make serve\b": r" at https?://",
    r"serve run ": r" is ready at http://",
    r"python router\.py": r"router at",
    r"tensorboard ": r"http://",
    r"tail -f ": r".",
    r"python -m anchorflow_ros\.node ": r"goal: none",
}
# SIOCSIFFLAGS sets IFF_UP: the loopback interface of a new namespace is down.
HOLD = """
import fcntl, socket, struct, sys
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
    fcntl.ioctl(any_socket, 0x8914, struct.pack("16sh22x", b"lo", 1))
print("up", flush=True)
sys.stdin.read()
"""
FETCHES = re.compile(r"(\S+/bin/)?pip (install|wheel) |make toolkit\b|make \.venv/")
"""Commands that need the network of the machine."""
STOP_S = 60.0  # for a server after Ctrl-C
GRACE_S = 5.0  # for its children after that


class TerminalError(AssertionError):
    """A command failed; the message has its output."""


class Loopback:
    """A network namespace with a loopback interface alone, until `close`.

    Raises `OSError` if this system does not support or allow it.
    """

    def __init__(self) -> None:
        self._holder = subprocess.Popen(
            ["unshare", "--user", "--map-root-user", "--net", sys.executable, "-c", HOLD],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert self._holder.stdout is not None
        if self._holder.stdout.readline() != "up\n":
            raise OSError(f"no network namespace: {self._holder.communicate()[1].strip()}")
        self._name = Path(f"/proc/{self._holder.pid}/ns/net").readlink()

    def enter(self) -> list[str]:
        """Return the prefix of a command to run in the namespace."""
        target = ("--target", str(self._holder.pid))
        return ["nsenter", *target, "--user", "--preserve-credentials", "--net"]

    def close(self) -> list[str]:
        """End all processes in the namespace; return the commands that had to be killed."""
        left = [ended(process) for process in Path("/proc").glob("[0-9]*") if self._holds(process)]
        self._holder.communicate()
        return [command for command in left if command]

    def _holds(self, process: Path) -> bool:
        with suppress(OSError):
            name = (process / "ns" / "net").readlink()
            return name == self._name and process.name != str(self._holder.pid)
        return False


def ended(process: Path) -> str:
    """Wait for a process by its folder in /proc; kill it after GRACE_S and return its command."""
    with suppress(OSError):  # it may end at any moment
        handle = os.pidfd_open(int(process.name))
        try:
            if select.select([handle], [], [], GRACE_S)[0]:
                return ""
            command = (process / "cmdline").read_text().replace("\0", " ").strip()
            signal.pidfd_send_signal(handle, signal.SIGKILL)
            return command
        finally:
            os.close(handle)
    return ""


class Server:
    """A command that runs until Ctrl-C."""

    def __init__(self, command: list[str], text: str, says: str, **place: object) -> None:
        self._text = text
        self._said: list[str] = []
        self._process = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
            **place,  # pyright: ignore[reportCallIssue, reportArgumentType]  # cwd and env
        )
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._said.append(line)
            if re.search(says, line):
                break
        else:
            self._process.wait()
            self._close()
            raise TerminalError(f"{text}\nended, having said\n{self.said}")
        self._reader = threading.Thread(target=self._said.extend, args=(self._process.stdout,))
        self._reader.start()

    @property
    def said(self) -> str:
        """Standard output and error so far."""
        return "".join(self._said)

    def _close(self) -> None:
        assert self._process.stdout is not None
        self._process.stdout.close()

    def stop(self) -> None:
        """Send Ctrl-C to the process group; raise `TerminalError` after a traceback."""
        try:
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGINT)
            self._process.wait(STOP_S)
        finally:
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
        self._reader.join()
        self._close()
        if "Traceback" in self.said:
            raise TerminalError(f"{self._text}\nsaid\n{self.said}")


class Terminal:
    """Runs commands in a folder one after the other; servers run until the end.

    programs: first folder of PATH
    """

    def __init__(self, folder: Path, *, programs: Path, env: Mapping[str, str]) -> None:
        self.folder = folder
        self._env = {**env, "PATH": f"{programs}:{env['PATH']}"}
        self._servers: list[Server] = []
        self._loopback = Loopback()

    def __enter__(self) -> Terminal:
        return self

    def __exit__(self, *_: object) -> None:
        try:
            while self._servers:
                self._servers.pop().stop()
        finally:
            left = self._loopback.close()
        if left:
            raise TerminalError(f"still running at the end: {left}")

    def type(self, text: str) -> str:
        """Run a command, or start it if it is a server; return its output.

        Raises `TerminalError` if it failed, or its output is an error of the contract.
        """
        # Background processes inherit an ignored SIGINT, so it is reset.
        shell = ["env", "--default-signal=INT", "bash", "-euo", "pipefail", "-c", text]
        command = shell if FETCHES.match(text) else [*self._loopback.enter(), *shell]
        for pattern, says in SERVERS.items():
            if re.match(pattern, text):
                server = Server(command, text, says, cwd=self.folder, env=self._env)
                self._servers.append(server)
                return server.said
        run = subprocess.run(
            command, cwd=self.folder, env=self._env, capture_output=True, text=True, check=False
        )
        if run.returncode != 0 or run.stdout.startswith('{"error"'):
            raise TerminalError(f"{text}\nended with {run.returncode}: {run.stdout}{run.stderr}")
        return run.stdout
