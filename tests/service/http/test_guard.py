"""The scopes of tokens on the application's routes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from fastapi import FastAPI
from starlette.routing import BaseRoute, Route

from anchorflow_client import AnchorClient, Unauthorized
from anchorflow_service.http import create_app
from anchorflow_service.http.tokens import TokenFile, scopes_for, token_line
from anchorflow_service.planning import PlanningService

TOKENS = {"robot": ("infer",), "chief": ("admin",), "both": ("infer", "admin")}


@pytest.fixture
def app(planning: PlanningService, tmp_path: Path) -> FastAPI:
    """The application with tokens; each token is its name and "-token"."""
    file = tmp_path / "tokens"
    lines = [token_line(name, scopes, f"{name}-token") for name, scopes in TOKENS.items()]
    file.write_text("\n".join(lines))
    return create_app(planning, tokens=TokenFile(file))


def flat(routes: Sequence[BaseRoute]) -> Iterator[Route]:
    """All routes, those of included routers too."""
    for route in routes:
        if isinstance(route, Route):
            yield route
        else:
            yield from flat(route.original_router.routes)  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("method", "path", "scopes"),
    [
        ("GET", "/v2/health/live", set()),
        ("GET", "/v2/health/ready", set()),
        ("GET", "/", set()),
        ("GET", "/page/js/app.js", set()),
        ("POST", "/page/flow", {"infer"}),
        ("POST", "/anchors", {"infer"}),
        ("GET", "/v2", {"infer"}),
        ("GET", "/v2/models/lines/ready", {"infer"}),
        ("POST", "/v2/models/lines/infer", {"infer"}),
        ("GET", "/openapi.json", {"infer"}),
        ("GET", "/metrics", {"infer", "admin"}),
        ("POST", "/v2/repository/index", {"admin"}),
        ("POST", "/v2/repository/models/lines/load", {"admin"}),
        ("POST", "/v2/repository", {"admin"}),
        ("GET", "/v2/repositories", {"infer"}),
        ("GET", "/something/new", {"infer"}),
    ],
)
def test_every_path_has_its_scopes(method: str, path: str, scopes: set[str]) -> None:
    assert scopes_for(method, path) == scopes


def test_no_route_is_open_but_health_and_the_pages_files(app: FastAPI) -> None:
    open_routes = {
        route.path
        for route in flat(app.routes)
        for method in route.methods or ()
        if not scopes_for(method, route.path)
    }

    assert {"/", "/v2/health/live", "/v2/health/ready"} <= open_routes
    rest = open_routes - {"/", "/v2/health/live", "/v2/health/ready"}
    assert all(path.startswith("/page/") for path in rest)
    assert "/page/flow" not in rest


def test_the_documentation_says_what_needs_a_token(service: Any) -> None:
    headers = {"Authorization": "Bearer robot-token"}
    schema = service.request("GET", "/openapi.json", headers=headers).json()

    assert schema["components"]["securitySchemes"] == {
        "token": {"type": "http", "scheme": "bearer"}
    }
    for path, operations in schema["paths"].items():
        for method, operation in operations.items():
            needs = bool(scopes_for(method.upper(), path))
            assert ("401" in operation["responses"]) == needs
            assert (operation.get("security") == [{"token": []}]) == needs


@pytest.mark.parametrize(
    ("headers", "message"),
    [
        ({}, "expected a bearer token, got none"),
        ({"Authorization": "robot-token"}, "expected a bearer token, got none"),
        ({"Authorization": "Basic robot-token"}, "expected a bearer token, got none"),
        ({"Authorization": "Bearer "}, "expected a bearer token, got none"),
        ({"Authorization": "Bearer wrong"}, "expected a token that is valid here"),
        ({"Authorization": "Bearer chief-token"}, "expected a token with the scope infer"),
    ],
)
def test_who_has_no_right_is_told_so_and_nothing_is_planned(
    service: Any, engine: Any, headers: dict[str, str], message: str
) -> None:
    answer = service.request("POST", "/anchors", headers=headers, content=b"x" * 100_000)

    assert answer.status_code == 401
    error = answer.json()["error"]
    assert (error["code"], error["field"]) == ("unauthorized", "Authorization")
    assert message in error["message"]
    assert answer.headers["www-authenticate"] == 'Bearer realm="anchorflow", scope="infer"'
    assert answer.headers["x-request-id"]
    assert "wrong" not in answer.text
    assert engine.seen == []


def test_the_client_shows_its_token(service: Any, fields: dict[str, Any]) -> None:
    assert AnchorClient("http://test", transport=service, token="robot-token").plan(**fields)
    with pytest.raises(Unauthorized, match="got none"):
        AnchorClient("http://test", transport=service).plan(**fields)
    assert AnchorClient("http://test", transport=service).ready()


def test_the_schemes_name_is_taken_in_any_case(service: Any) -> None:
    headers = {"authorization": "bearer  robot-token "}

    assert service.request("GET", "/v2/models", headers=headers).status_code == 200
