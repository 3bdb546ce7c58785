"""Services for the programs of the pages."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import uvicorn
from image_planner import write_image_bundle

from anchorflow_cli.listening import listen, url_of
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_service.engine import Engine
from anchorflow_service.http import create_app
from anchorflow_service.planning import PlanningService

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


@pytest.fixture(scope="session")
def default_engine() -> Engine:
    """Open the default bundle."""
    return Engine(load_bundle(DEFAULT_BUNDLE), threads=1)


@pytest.fixture(scope="session")
def service_url(default_engine: Engine) -> Iterator[str]:
    """Run a service of that bundle on a free port."""
    with served(default_engine) as url:
        yield url


@pytest.fixture
def url_of_both(default_engine: Engine, tmp_path: Path) -> Iterator[str]:
    """Run a service of that bundle and of a planner without a cost map."""
    camera = Engine(load_bundle(write_image_bundle(tmp_path)), threads=1)
    with served(default_engine, camera) as url:
        yield url


@contextmanager
def served(*engines: Engine) -> Iterator[str]:
    """Serve engines, the first as the default, and yield the URL."""
    by_name = {engine.card.name: engine for engine in engines}
    app = create_app(PlanningService(by_name, default=engines[0].card.name))
    server = uvicorn.Server(uvicorn.Config(app, log_level="warning", ws="none"))
    with listen("127.0.0.1", 0) as listener:
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        while not server.started:
            assert thread.is_alive()
            time.sleep(0.01)
        yield url_of(listener)
        server.should_exit = True
        thread.join(20)
    assert not thread.is_alive()
