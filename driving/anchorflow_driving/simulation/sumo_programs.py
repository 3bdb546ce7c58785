"""The programs that come with SUMO (`eclipse-sumo` on PyPI)."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import sumo

from anchorflow_client.errors import AnchorFlowError

HOME = Path(sumo.SUMO_HOME)


class SimulationError(AnchorFlowError):
    """SUMO could not do what it was asked; the message has its own words."""


def run_program(name: str, *arguments: str) -> None:
    """Runs netgenerate or netconvert.

    Raises:
        SimulationError: it failed.
    """
    done = subprocess.run(
        [str(HOME / "bin" / name), *arguments],
        check=False,
        capture_output=True,
        text=True,
        env={**os.environ, "SUMO_HOME": str(HOME)},
    )
    if done.returncode:
        raise SimulationError(f"{name}: {done.stderr.strip() or done.returncode}")
