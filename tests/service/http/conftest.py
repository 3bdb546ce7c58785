"""The application over engines that draw straight lines, in this process or on a socket."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any, Protocol

import numpy as np
import pytest
import uvicorn
from fastapi import FastAPI
from served import InProcess, in_process
from straight_lines import StraightLines

from anchorflow_cli.listening import listen as listen_at, url_of
from anchorflow_service.http import create_app
from anchorflow_service.http.lifecycle import uvicorn_config
from anchorflow_service.planning import PlanningService


class Run(Protocol):
    """Starts an application and stops it when the test ends."""

    def __call__(self, app: FastAPI) -> InProcess: ...


@pytest.fixture
def run() -> Iterator[Run]:
    """Starts applications in this process."""
    with ExitStack() as stack:
        yield lambda app: stack.enter_context(in_process(app))


class Served:
    """An application under uvicorn on a thread, on a free port of this machine."""

    def __init__(self, app: FastAPI, **settings: Any) -> None:
        self.server = server = uvicorn.Server(uvicorn_config(app, **settings))
        listener = listen_at("127.0.0.1", 0)
        self.port = listener.getsockname()[1]
        self.url = url_of(listener)
        self._thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        self._thread.start()
        while not server.started:
            assert self._thread.is_alive()
            time.sleep(0.01)

    def has_stopped(self, within_s: float = 20) -> bool:
        """Whether it stops in that time."""
        self._thread.join(within_s)
        return not self._thread.is_alive()


class Serve(Protocol):
    """Starts a server and stops it when the test ends."""

    def __call__(self, app: FastAPI, **settings: Any) -> Served: ...


@pytest.fixture
def serve() -> Iterator[Serve]:
    """Starts applications with settings of `uvicorn_config`."""
    started: list[Served] = []

    def start(app: FastAPI, **settings: Any) -> Served:
        started.append(Served(app, **settings))
        return started[-1]

    yield start
    for each in started:
        each.server.should_exit = True
        assert each.has_stopped()


@pytest.fixture
def listen(serve: Serve) -> Callable[[FastAPI], str]:
    """Starts applications and returns their URL."""
    return lambda app: serve(app).url


@pytest.fixture
def app(planning: PlanningService) -> FastAPI:
    """The application over two engines that draw straight lines."""
    return create_app(planning)


@pytest.fixture
def service(app: FastAPI, run: Run) -> InProcess:
    """The application, running in this process."""
    return run(app)


@pytest.fixture
def free(free_engine: StraightLines, run: Run) -> InProcess:
    """A service of the model whose anchors have their own durations."""
    return run(create_app(PlanningService({"lines": free_engine}, default="lines")))


@pytest.fixture
def body(fields: dict[str, Any]) -> dict[str, Any]:
    """The request of `fields` in the Open Inference Protocol, all in JSON."""
    values = {
        "cost_map": fields["cost_map"]["data"],
        "map_geometry": [-5.0, -4.0, 0.5],
        "x_curr": fields["x_curr"],
        "x_goal": fields["x_goal"],
    }
    inputs = [
        {"name": name, "datatype": "FP64", "shape": [*np.shape(value)], "data": value}
        for name, value in values.items()
    ]
    return {
        "inputs": [inputs[0] | {"datatype": "FP32"}, *inputs[1:]],
        "parameters": {"num_samples": 4, "seed": 1},
    }
