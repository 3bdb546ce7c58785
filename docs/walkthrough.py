"""Run the commands that the documentation prints in a fresh checkout: `make walkthrough`.

Everything is installed and trained in a temporary folder; pictures of the page are kept in
`runs/page`.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter

from anchorflow_docs.commands.printed import ROOT, printed_texts
from anchorflow_docs.commands.sessions import WALKTHROUGH
from anchorflow_docs.commands.terminal import Loopback, Terminal, TerminalError

# Variables of this process and its make; the checkout has its own environment.
OWN = ("MAKEFLAGS", "MAKELEVEL", "MFLAGS", "PYTHONPATH", "VIRTUAL_ENV")
PICTURES = Path("runs", "page")


def main() -> None:
    """Run all sessions in order; the first failure exits with status 1."""
    try:
        Loopback().close()
    except OSError as error:
        sys.stdout.write(f"skipped: the walkthrough: no loopback of its own here: {error}\n")
        return
    texts = printed_texts()
    environment = {name: value for name, value in os.environ.items() if name not in OWN}
    environment["RAY_AUTH_MODE"] = "disabled"
    with tempfile.TemporaryDirectory(prefix="anchorflow-walkthrough-") as name:
        folder = Path(name, "anchorflow")
        check_out(folder)
        for session in WALKTHROUGH:
            if subprocess.run(
                session.tool, shell=True, capture_output=True, check=False
            ).returncode:
                sys.stdout.write(f"skipped: {session.name}: no success of {session.tool}\n")
                continue
            for make in session.given:
                make(folder)
            programs = folder / ".venv" / "bin"
            try:
                with Terminal(folder, programs=programs, env=environment) as terminal:
                    for command in session.before:
                        timed(terminal, command, command)
                    for command in session.commands:
                        timed(terminal, command, texts[command])
            except TerminalError as error:
                raise SystemExit(f"{session.name}: {error}") from error
        if (folder / PICTURES).is_dir():
            shutil.copytree(folder / PICTURES, ROOT / PICTURES, dirs_exist_ok=True)


def check_out(folder: Path) -> None:
    """Copy tracked files, and untracked ones that git does not ignore."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    )
    for path in filter(None, listed.stdout.split("\0")):
        if (ROOT / path).is_file():  # a removed file is listed until it is committed
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / path, folder / path)


def timed(terminal: Terminal, name: str, text: str) -> None:
    """Run a command and print its time."""
    start = perf_counter()
    terminal.type(text)
    sys.stdout.write(f"{perf_counter() - start:6.1f} s  {name}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
