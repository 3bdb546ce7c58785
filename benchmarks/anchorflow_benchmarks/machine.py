"""Where and when something was measured."""

from __future__ import annotations

import os
import platform
import subprocess
from datetime import datetime, timezone
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from anchorflow_trajectory.cores import usable_cores

PACKAGES = ("numpy", "onnxruntime", "torch", "ompl")


def circumstances() -> dict[str, str]:
    """Date, commit, machine, load and versions, as they stand beside every result."""
    return {
        "date": datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M UTC"),
        "commit": commit(),
        "machine": f"{processor()}, {usable_cores()} of {os.cpu_count()} cores",
        "load": ", ".join(f"{mean:.2f}" for mean in os.getloadavg()) + " (1, 5, 15 min)",
        "versions": ", ".join(f"{name} {_version(name)}" for name in ("python", *PACKAGES)),
    }


def commit() -> str:
    """The checkout's commit, with a plus where files differ from it; unknown outside a checkout."""
    folder = Path(__file__).parent
    try:
        head = _git(folder, "rev-parse", "--short", "HEAD")
        changed = _git(folder, "status", "--porcelain", "--untracked-files=no")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return f"{head}+" if changed else head


def processor() -> str:
    """The processor's name."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:  # Linux alone has it
        return platform.processor() or platform.machine()
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.machine())


def _git(folder: Path, *arguments: str) -> str:
    command = ("git", *arguments)
    answer = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)
    return answer.stdout.strip()


def _version(name: str) -> str:
    if name == "python":
        return platform.python_version()
    try:
        return version(name)
    except PackageNotFoundError:
        return "absent"
