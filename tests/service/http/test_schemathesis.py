"""The served OpenAPI description against the service, by schemathesis with all its checks."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from fastapi import FastAPI
from served import app_of

CONFIG = Path(__file__).with_name("schemathesis.toml")
EXAMPLES, SEED = 30, 1
PATIENCE_S = 280


@pytest.fixture
def app(tiny_bundle: Path) -> FastAPI:
    return app_of(tiny_bundle)


def test_every_answer_is_as_the_description_says(
    app: FastAPI, listen: Callable[[FastAPI], str], tmp_path: Path
) -> None:
    pytest.importorskip("schemathesis", reason="schemathesis is not installed")
    program = Path(sys.executable).with_name("schemathesis")
    command = [program, "--config-file", CONFIG, "run", f"{listen(app)}/openapi.json"]
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
