"""The service on Ray Serve: two replicas, one of them killed under load."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = Path(__file__).with_name("ray_under_load.py")


def test_no_request_is_lost_where_a_replica_is() -> None:
    pytest.importorskip("ray.serve", reason="Ray Serve is not installed: anchorflow[ray]")
    # In a process of its own: Ray warns of what it deprecates itself, and leaves threads behind.
    run = subprocess.run(
        [sys.executable, str(PROGRAM)],
        check=False,
        capture_output=True,
        text=True,
        timeout=600,
        env={**os.environ, "RAY_AUTH_MODE": "disabled"},
    )
    assert run.returncode == 0, run.stderr
    # Ray's own processes may write to the same place until they have ended.
    (line,) = (line for line in run.stdout.splitlines() if line.startswith("{"))
    told = json.loads(line)

    assert told["replicas"][0] == 2
    assert told["killed"]
    assert told["answers"] > 10
    assert told["failed"] == {}
    assert told["models"] == 1
