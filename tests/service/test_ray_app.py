"""The service on Ray Serve: a replica by itself, and two of them, one killed under load."""

from __future__ import annotations

import asyncio
import importlib
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace

import httpx
import pytest

from anchorflow_client import AnchorRequest
from anchorflow_client.codec import JsonCodec

PROGRAM = Path(__file__).with_name("ray_under_load.py")


@pytest.fixture
def ray_app(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """The module; what it needs of Ray to be imported is nothing."""
    name = "anchorflow_service.ray_app"
    monkeypatch.setitem(sys.modules, "ray", SimpleNamespace(serve=SimpleNamespace()))
    sys.modules.pop(name, None)
    yield importlib.import_module(name)
    del sys.modules[name]


def test_a_replica_refuses_what_its_queue_has_no_room_for(
    ray_app: ModuleType, tiny_bundle: Path, small_request: Callable[..., AnchorRequest]
) -> None:
    """And so keeps budgets and robots apart, as the queue does elsewhere."""
    settings = ray_app.RaySettings(bundle=tiny_bundle, max_batch=2, batch_wait_ms=1.5)
    assert settings.limits().batch_wait_ms == 1.5
    app = ray_app.build_replica(settings)
    body = JsonCodec().encode_request(small_request()).body
    most = settings.limits().max_waiting + 1  # waiting, or on its one lane

    async def statuses() -> list[int]:
        transport = httpx.ASGITransport(app=app)
        async with (
            app.router.lifespan_context(app),
            httpx.AsyncClient(transport=transport, base_url="http://test", timeout=60) as client,
        ):
            headers = {"Content-Type": "application/json"}
            asked = [
                client.post("/anchors", content=body, headers=headers) for _ in range(3 * most)
            ]
            return [answer.status_code for answer in await asyncio.gather(*asked)]

    came = asyncio.run(statuses())
    assert set(came) == {200, 429}
    assert came.count(200) >= most


def test_no_request_is_lost_where_a_replica_is() -> None:
    pytest.importorskip("ray.serve", reason="Ray Serve is not installed: anchorflow[ray]")
    # A separate process, since Ray warns of its own deprecations and leaves threads running.
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
