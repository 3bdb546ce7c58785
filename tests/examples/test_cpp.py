"""The C++ example, compiled by the system's compiler against libcurl, plans over a socket."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import uvicorn

from anchorflow_client import AnchorClient
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_service.engine import Engine
from anchorflow_service.http import create_app
from anchorflow_service.planning import PlanningService

SOURCE = Path(__file__).resolve().parents[2] / "examples" / "cpp" / "anchors.cpp"
START_S = 30.0


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    compiler = os.environ.get("CXX") or shutil.which("g++")
    if compiler is None:
        pytest.skip("there is no g++")
    out = tmp_path_factory.mktemp("cpp") / "anchors"
    flags = ("-std=c++17", "-O1", "-Wall", "-Wextra", "-Werror")
    link = subprocess.run(
        [compiler, "-x", "c++", "-", "-lcurl", "-o", out],
        input=b"#include <curl/curl.h>\nint main() { return !curl_easy_init(); }",
        check=False,
        capture_output=True,
    )
    if link.returncode:
        pytest.skip("there is no libcurl with headers (libcurl4-openssl-dev)")
    subprocess.run([compiler, *flags, SOURCE, "-lcurl", "-o", out], check=True)
    return out


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    engine = Engine(load_bundle(DEFAULT_BUNDLE.parent / "student"), threads=1)
    service = PlanningService({engine.card.name: engine}, default=engine.card.name)
    server = uvicorn.Server(uvicorn.Config(create_app(service), log_config=None))
    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        while not server.started and thread.is_alive():
            time.sleep(0.01)
        yield f"http://127.0.0.1:{listener.getsockname()[1]}"
        server.should_exit = True
        thread.join(START_S)


def test_it_prints_the_best_anchor(program: Path, url: str) -> None:
    answer = subprocess.run([program, url], check=True, capture_output=True, text=True)
    said, *points = answer.stdout.splitlines()
    places = [tuple(map(float, point.split())) for point in points]

    assert said.endswith("of 64 anchors are safe")
    assert int(said.split()[0]) > 0
    assert places[0] == (-3.0, 0.0)
    assert places[-1] == pytest.approx((3.0, 0.0), abs=1e-3)
    assert max(abs(y) for _, y in places) > 1.5  # round the wall
    with AnchorClient(url) as client:
        assert client.ready()


def test_a_refusal_is_printed(program: Path, url: str) -> None:
    answer = subprocess.run(
        [program, f"{url}/nowhere"], check=False, capture_output=True, text=True
    )
    assert answer.returncode == 1
    assert '"code":"invalid_request"' in answer.stderr.replace(" ", "") or "404" in answer.stderr
