"""Golden files: JSON with a line for each key, so that many numbers are one line of a diff."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

WRITES = "ANCHORFLOW_WRITE_GOLDEN" in os.environ


def golden(path: Path, made: dict[str, Any]) -> dict[str, Any]:
    """Read a golden file, which is written first if ANCHORFLOW_WRITE_GOLDEN is set."""
    if WRITES:
        rows = (f" {json.dumps(key)}: {json.dumps(value)}" for key, value in made.items())
        path.write_text("{\n" + ",\n".join(rows) + "\n}\n")
    return json.loads(path.read_text())
