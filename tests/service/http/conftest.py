"""The application over engines that draw straight lines, in this process or on a socket."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import AsyncIterable, Callable, Iterator, Mapping
from contextlib import ExitStack
from typing import Any, Protocol

import httpx
import pytest
import uvicorn
from anyio.from_thread import BlockingPortal, start_blocking_portal
from fastapi import FastAPI

from anchorflow_cli.listening import listen as listen_at
from anchorflow_cli.listening import url_of
from anchorflow_service.http import create_app
from anchorflow_service.http.lifecycle import uvicorn_config
from anchorflow_service.planning import PlanningService


class InProcess:
    """The application without a socket, inside its lifespan; also a client's transport."""

    def __init__(self, app: FastAPI, portal: BlockingPortal) -> None:
        self._app = app
        self._portal = portal

    def request(
        self,
        method: str,
        path: str,
        *,
        headers: Mapping[str, str] | None = None,
        content: bytes | AsyncIterable[bytes] | None = None,
    ) -> httpx.Response:
        """One request of any kind, on the event loop's own thread."""
        return self._portal.call(self._request, method, path, headers, content)

    def post(self, body: Any) -> httpx.Response:
        """JSON to /anchors; bytes go as they are."""
        content = body if isinstance(body, bytes) else json.dumps(body).encode()
        headers = {"Content-Type": "application/json"}
        return self.request("POST", "/anchors", headers=headers, content=content)

    def send(
        self,
        method: str,
        path: str,
        headers: Mapping[str, str],
        body: bytes | None,
        timeout_s: float,  # noqa: ARG002 - nothing here can hang but the test itself
    ) -> tuple[int, Mapping[str, str], bytes]:
        """As a transport of `AnchorClient`."""
        answer = self.request(method, path, headers=headers, content=body)
        return answer.status_code, answer.headers, answer.content

    def close(self) -> None:
        """Nothing to let go of."""

    async def _request(self, method: str, path: str, headers: Any, content: Any) -> httpx.Response:
        transport = httpx.ASGITransport(app=self._app)
        async with httpx.AsyncClient(transport=transport, base_url="http://test") as client:
            return await client.request(method, path, headers=headers, content=content)


class Run(Protocol):
    """Starts an application and stops it when the test ends."""

    def __call__(self, app: FastAPI) -> InProcess: ...


@pytest.fixture
def run() -> Iterator[Run]:
    """Starts applications in this process."""
    with ExitStack() as stack:

        def start(app: FastAPI) -> InProcess:
            portal = stack.enter_context(start_blocking_portal())
            lifespan = portal.wrap_async_context_manager(app.router.lifespan_context(app))
            stack.enter_context(lifespan)
            return InProcess(app, portal)

        yield start


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
