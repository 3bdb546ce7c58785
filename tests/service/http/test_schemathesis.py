"""The served OpenAPI description against the service, by schemathesis with all its checks."""

from __future__ import annotations

import json
import subprocess
import sys
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from fastapi import FastAPI
from served import app_of

CONFIG = Path(__file__).with_name("schemathesis.toml")
EXAMPLES, SEED = 8, 1
PATIENCE_S = 280
MOST_ENTRIES = 8
"""Longer arrays may be shorter too: maps of 16 x 16 and more take minutes to draw."""


@pytest.fixture
def app(tiny_bundle: Path) -> FastAPI:
    return app_of(tiny_bundle)


def with_short_arrays(node: Any) -> Any:
    """Return a description without the least lengths of its long arrays."""
    if isinstance(node, list):
        return [with_short_arrays(part) for part in node]
    if not isinstance(node, dict):
        return node
    return {
        name: with_short_arrays(part)
        for name, part in node.items()
        if not (name == "minItems" and isinstance(part, int) and part > MOST_ENTRIES)
    }


def test_every_answer_is_as_the_description_says(
    app: FastAPI, listen: Callable[[FastAPI], str], tmp_path: Path
) -> None:
    pytest.importorskip("schemathesis", reason="schemathesis is not installed")
    program = Path(sys.executable).with_name("schemathesis")
    url, description = listen(app), tmp_path / "openapi.json"
    with urllib.request.urlopen(f"{url}/openapi.json") as served:
        description.write_text(json.dumps(with_short_arrays(json.load(served))))
    command = [program, "--config-file", CONFIG, "run", description, "--url", url]
    options = ["--checks", "all", "--max-examples", EXAMPLES, "--seed", SEED, "--no-color"]

    run = subprocess.run(
        [str(part) for part in (*command, *options)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )

    assert run.returncode == 0, run.stdout[-8000:] + run.stderr
