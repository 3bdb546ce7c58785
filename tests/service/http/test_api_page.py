"""`/docs`: every endpoint, with examples that can be typed, and nothing from elsewhere."""

from __future__ import annotations

import re
from html import unescape
from typing import Any


def test_it_lists_every_endpoint_and_loads_nothing_from_elsewhere(service: Any) -> None:
    answer = service.request("GET", "/docs")
    paths = service.request("GET", "/openapi.json").json()["paths"]

    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith("text/html")
    assert "default-src 'none'" in answer.headers["content-security-policy"]
    for path, methods in paths.items():
        for method in methods:
            assert f"{method.upper()}</span> {path}</h2>" in answer.text
    for link in re.findall(r'(?:src|href)="([^"]+)"', answer.text):
        assert service.request("GET", link).status_code == 200
    assert "<script" not in answer.text


def test_its_example_of_a_request_is_answered(service: Any) -> None:
    page = unescape(service.request("GET", "/docs").text)
    (typed,) = re.findall(r"/anchors -H 'Content-Type: application/json' -d '([^']+)'", page)

    answer = service.request("POST", "/anchors", content=typed.encode())
    assert answer.status_code == 200
    assert len(answer.json()["trajectories"]) == 4


def test_a_host_that_is_none_is_not_repeated(service: Any) -> None:
    headers = {"Host": "<b>x</b>"}
    page = service.request("GET", "/docs", headers=headers).text
    assert "<b>" not in page
    assert "http://127.0.0.1:8000/anchors" in page
