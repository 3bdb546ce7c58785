"""The pages, and a service of the default bundle that their programs ask."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import uvicorn

from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_service.engine import Engine
from anchorflow_service.http import create_app
from anchorflow_service.planning import PlanningService

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


@pytest.fixture(scope="session")
def default_engine() -> Engine:
    """The bundle that ships, opened."""
    return Engine(load_bundle(DEFAULT_BUNDLE), threads=1)


@pytest.fixture(scope="session")
def service_url(default_engine: Engine) -> Iterator[str]:
    """Where a service of that bundle listens, on a free port of this machine."""
    name = default_engine.card.name
    app = create_app(PlanningService({name: default_engine}, default=name))
    server = uvicorn.Server(uvicorn.Config(app, log_level="warning", ws="none"))
    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        while not server.started:
            assert thread.is_alive()
            time.sleep(0.01)
        yield f"http://127.0.0.1:{listener.getsockname()[1]}"
        server.should_exit = True
        thread.join(20)
    assert not thread.is_alive()
