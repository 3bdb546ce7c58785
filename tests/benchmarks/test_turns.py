"""What a timing leaves of the process that it was taken in."""

from __future__ import annotations

import subprocess
import sys

import pytest

# Bindings that hold their modules in cycles, which only the collector undoes when the process ends.
TIMED = """
from ompl import base
from anchorflow_benchmarks.turns import spare_the_collector
with spare_the_collector():
    pass
"""


def test_a_process_that_took_timings_ends_quietly() -> None:
    pytest.importorskip("ompl")

    run = subprocess.run(
        [sys.executable, "-c", TIMED], check=True, capture_output=True, text=True, timeout=60
    )

    assert (run.stdout, run.stderr) == ("", "")
