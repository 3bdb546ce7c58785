"""The application over an engine that draws straight lines, in this process or on a socket."""

from __future__ import annotations

import json
import socket
import threading
import time
from collections.abc import AsyncIterable, Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from typing import Any, Protocol

import httpx
import numpy as np
import pytest
import uvicorn
from anyio.from_thread import BlockingPortal, start_blocking_portal
from fastapi import FastAPI

from anchorflow_client import (
    AnchorBatch,
    AnchorRequest,
    MapSpec,
    ModelCard,
    RefineSpec,
    SamplerSpec,
    TensorSpec,
)
from anchorflow_service.http import create_app

CARD = ModelCard(
    name="lines",
    version="1.2.3",
    sha256="ab" * 32,
    planner="lines",
    inputs=(TensorSpec("x_curr", "float32", ("B", 6), "m, m/s, m/s^2"),),
    outputs=(TensorSpec("positions", "float32", ("B", "N", "T", "D"), "m"),),
    T=16,
    D=2,
    horizon_s=8.0,
    dt=8.0 / 15,
    v_max=2.0,
    a_max=3.0,
    robot_radius=0.25,
    map=MapSpec(H=64, W=64, channels=3),
    sampler=SamplerSpec("rk4", (0.0, 0.5, 1.0)),
    refine=RefineSpec(smooth=True, project=True, safety_margin=0.05, guidance=0.0),
    adjustable=("robot_radius",),
)


def minimum_jerk(steps: int) -> np.ndarray:
    """Position, velocity and acceleration [3,steps] from rest at 0 to rest at 1 in unit time."""
    s = np.linspace(0, 1, steps)
    position = 10 * s**3 - 15 * s**4 + 6 * s**5
    return np.stack([position, 30 * (s - s**2) ** 2, 60 * s - 180 * s**2 + 120 * s**3])


class StraightLines:
    """An engine: minimum-jerk motion along straight lines, fanned out by a seeded draw.

    `before_answer` sees each request and what would be answered, and gives what is answered: here
    a test lets the engine block, fail or answer nonsense.
    """

    def __init__(self, card: ModelCard = CARD) -> None:
        self.card = card
        self.seen: list[AnchorRequest] = []
        self.before_answer: Callable[[AnchorBatch], AnchorBatch] = lambda batch: batch

    def plan(self, request: AnchorRequest, /) -> AnchorBatch:
        """[B,N,T,2], the B axis dropped where the request is not batched."""
        self.seen.append(request)
        profile = minimum_jerk(self.card.T)
        scenes = [self._scene(request, b, profile) for b in range(request.num_scenes)]
        arrays: dict[str, Any] = {
            name: np.stack([scene[name] for scene in scenes]) for name in scenes[0]
        }
        if not request.batched:
            arrays = {name: array[0] for name, array in arrays.items()}
        return self.before_answer(
            AnchorBatch(
                **arrays,
                dt=self.card.dt,
                seed=request.seed or 0,
                model=self.card.id,
                timing_ms={"encode": 1.0, "sample": 2.0, "refine": 3.0, "total": 6.0},
            )
        )

    def _scene(self, request: AnchorRequest, scene: int, profile: np.ndarray) -> dict[str, Any]:
        start, goal = request.x_curr[scene, :2], request.x_goal[scene, :2]
        fan = np.random.default_rng(request.seed).normal(size=(request.num_samples, 1, 1)) * 0.01
        line = profile[:, None, :, None] * (goal - start) + fan * profile[:, None, :, None]
        line[0] += start
        names = ("trajectories", "velocities", "accelerations")
        per_anchor = np.abs(fan[:, 0, 0])
        return dict(zip(names, line, strict=True)) | {
            "scores": -per_anchor,
            "clearance": per_anchor,
            "safe": per_anchor < 1,
        }


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


@pytest.fixture
def listen() -> Iterator[Callable[[FastAPI], str]]:
    """Starts applications under uvicorn on a free port of this machine; gives their URL."""
    stops: list[tuple[uvicorn.Server, threading.Thread]] = []

    def start(app: FastAPI) -> str:
        server = uvicorn.Server(uvicorn.Config(app, log_level="warning", ws="none"))
        listener = socket.create_server(("127.0.0.1", 0))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        stops.append((server, thread))
        while not server.started:
            assert thread.is_alive()
            time.sleep(0.01)
        return f"http://127.0.0.1:{listener.getsockname()[1]}"

    yield start
    for server, thread in stops:
        server.should_exit = True
        thread.join(20)
        assert not thread.is_alive()


@pytest.fixture
def engine() -> StraightLines:
    """The default model of `app`."""
    return StraightLines()


@pytest.fixture
def app(engine: StraightLines) -> FastAPI:
    """The application over that engine and a second model."""
    second = StraightLines(replace(CARD, name="bows", adjustable=()))
    return create_app({"lines": engine, "bows": second}, default="lines")


@pytest.fixture
def service(app: FastAPI, run: Run) -> InProcess:
    """The application, running in this process."""
    return run(app)


@pytest.fixture
def fields() -> dict[str, Any]:
    """A good request over a free map of 16 x 20 cells, 0.5 m each."""
    return {
        "cost_map": {"data": np.zeros((1, 16, 20)).tolist(), "resolution": 0.5},
        "x_curr": [-3.0, 0.5, 0.0, 0.0, 0.0, 0.0],
        "x_goal": [3.0, 0.5, 0.0, 0.0],
        "num_samples": 4,
        "seed": 1,
    }
