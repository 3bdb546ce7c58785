"""The served OpenAPI description against the service, by schemathesis with all its checks."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from fastapi import FastAPI

from anchorflow_service.bundle import load_bundle
from anchorflow_service.engine import Engine
from anchorflow_service.http import create_app
from anchorflow_service.planning import PlanningService, ServiceLimits
from anchorflow_service.repository import BundleFolders, Repository

CONFIG = Path(__file__).with_name("schemathesis.toml")
EXAMPLES, SEED = 30, 1
PATIENCE_S = 280


def opened(folder: Path) -> Engine:
    return Engine(load_bundle(folder), threads=1)


@pytest.fixture
def app(tiny_bundle: Path) -> FastAPI:
    """The tiny bundle, served; its repository can load it again."""
    service = PlanningService({"tiny": opened(tiny_bundle)}, default="tiny", limits=ServiceLimits())
    repository = Repository(service.engines, BundleFolders([tiny_bundle]), opened)
    return create_app(service, repository=repository)


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
