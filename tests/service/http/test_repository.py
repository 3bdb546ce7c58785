"""The routes of the repository, and a swap while requests come."""

from __future__ import annotations

import json
import threading
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from served import app_of
from written_graphs import set_in_manifest

from anchorflow_client import AnchorClient, AnchorRequest
from anchorflow_service.http import create_app
from anchorflow_service.planning import PlanningService

SWAPS = 20
CLIENTS = 4


@pytest.fixture
def service(tiny_bundle: Path, run: Any) -> Any:
    return run(app_of(tiny_bundle))


def post(service: Any, path: str, body: Any = None) -> Any:
    content = body if isinstance(body, bytes | None) else json.dumps(body).encode()
    return service.request("POST", f"/v2/repository/{path}", content=content)


def test_loading_and_unloading(service: Any, tiny_bundle: Path) -> None:
    set_in_manifest(tiny_bundle, "version", to="2.0")

    loaded = post(service, "models/tiny/load")
    assert (loaded.status_code, loaded.json()) == (
        200,
        {"name": "tiny", "version": "2.0", "state": "READY", "reason": ""},
    )
    assert post(service, "index").json() == [loaded.json()]
    assert post(service, "models/tiny/unload", {"parameters": {}}).status_code == 200
    assert post(service, "index", {"ready": True}).json() == []
    assert service.request("GET", "/v2/models/tiny/ready").status_code == 404
    assert post(service, "models/tiny/load", {"parameters": {"version": "2.0"}}).status_code == 200


def test_a_broken_bundle_is_refused_with_the_reason_and_without_a_path(
    service: Any, tiny_bundle: Path, small_request: Callable[..., AnchorRequest]
) -> None:
    (tiny_bundle / "field.onnx").write_bytes(b"broken")

    answer = post(service, "models/tiny/load")

    error = answer.json()["error"]
    assert (answer.status_code, error["code"]) == (422, "invalid_request")
    assert error["message"].startswith("tiny was not taken: field.onnx: its sha256 is")
    assert str(tiny_bundle) not in answer.text
    client = AnchorClient("http://test", transport=service)
    assert client.plan_request(small_request()).model.version == "1.2.3"


@pytest.mark.parametrize(
    ("path", "body", "status", "field"),
    [
        ("models/nobody/load", None, 404, "model"),
        ("models/nobody/unload", None, 404, "model"),
        ("models/tiny/load", {"parameters": {"version": "9"}}, 404, "model"),
        ("models/tiny/load", {"parameters": {"version": 9}}, 422, "parameters.version"),
        ("models/tiny/load", {"parameters": {"config": "{}"}}, 422, "parameters.config"),
        ("models/tiny/load", {"parameters": [1]}, 422, "parameters"),
        ("models/tiny/load", [1], 422, "body"),
        ("models/tiny/load", b"{", 422, "body"),
        ("models/tiny/load", b" " * 70_000, 413, "body"),
        ("models/tiny/unload", {"parameters": {"unload_dependents": 1}}, 422, "parameters."),
        ("index", {"ready": "yes"}, 422, "ready"),
        ("models/..%2f..%2ftiny/load", None, 404, None),
    ],
)
def test_what_is_refused(
    service: Any, path: str, body: Any, status: int, field: str | None
) -> None:
    answer = post(service, path, body)

    error = answer.json()["error"]
    assert answer.status_code == status
    assert field is None or error["field"].startswith(field)


def test_without_a_repository_there_are_no_such_routes(planning: PlanningService, run: Any) -> None:
    assert post(run(create_app(planning)), "index").status_code == 404


def test_twenty_swaps_while_requests_come_and_none_fails(
    service: Any, tiny_bundle: Path, small_request: Callable[..., AnchorRequest]
) -> None:
    """Every answer names the version that made it, and the one after a swap is the new one."""
    done = threading.Event()
    request = small_request()

    def ask() -> Counter[str]:
        client = AnchorClient("http://test", transport=service)
        versions: Counter[str] = Counter()
        while not done.is_set():
            versions[client.plan_request(request).model.version] += 1
        return versions

    with ThreadPoolExecutor(CLIENTS) as executor:
        clients = [executor.submit(ask) for _ in range(CLIENTS)]
        mine = AnchorClient("http://test", transport=service)
        try:
            for swap in range(SWAPS):
                set_in_manifest(tiny_bundle, "version", to=f"2.{swap}")
                assert post(service, "models/tiny/load").status_code == 200
                assert mine.plan_request(request).model.version == f"2.{swap}"
        finally:
            done.set()
        versions = sum((each.result() for each in clients), Counter())

    assert set(versions) <= {"1.2.3", *(f"2.{swap}" for swap in range(SWAPS))}
    assert len(versions) > 1
