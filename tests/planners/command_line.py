"""Run `anchorflow` commands in this process, and servers and programs in their own."""

from __future__ import annotations

import subprocess
import sys
from contextlib import redirect_stderr
from io import StringIO

import pytest

from anchorflow_cli.main import main

COMMAND = "from anchorflow_cli.main import main; main()"


def succeed(*arguments: object) -> None:
    """Run a command, which must end with status 0."""
    with pytest.raises(SystemExit) as caught:
        main([*map(str, arguments)])
    assert caught.value.code in (0, None), caught.value.code


def failure(*arguments: object) -> str:
    """Run a command, which must fail with one line or a usage error; return its message."""
    shown = StringIO()
    with pytest.raises(SystemExit) as caught, redirect_stderr(shown):
        main([*map(str, arguments)])
    code = caught.value.code
    assert code not in (0, None)
    if isinstance(code, int):
        return " ".join(shown.getvalue().split())
    assert code is not None
    assert code.startswith(f"anchorflow {arguments[0]}")
    assert "\n" not in code
    return code


def printed_by(shell: str, program: str) -> str:
    """Run a program by `bash` or Python, which must end with status 0; return what it prints."""
    ran = subprocess.run(
        [shell, "-c", program], check=True, capture_output=True, text=True, timeout=120
    )
    return ran.stdout


class Served:
    """`anchorflow serve` on a free port, which has printed its first `line` with the `url`."""

    def __init__(self, *options: str, program: str = COMMAND) -> None:
        """program: Python that runs the command of `sys.argv`"""
        self.process = subprocess.Popen(
            [sys.executable, "-u", "-c", program, "serve", "--port", "0", *options],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.line = self.read_line()
        self.url = self.line.partition(" at ")[2].partition(" ")[0]

    def read_line(self) -> str:
        assert self.process.stdout is not None
        return self.process.stdout.readline().rstrip("\n")

    def ended(self, number: int | None = None) -> tuple[int, list[str]]:
        """Send a signal, if any, and wait for the end; return the status and further lines."""
        if number is not None:
            self.process.send_signal(number)
        output, errors = self.process.communicate(timeout=60)
        return self.process.returncode, (output + errors).splitlines()
