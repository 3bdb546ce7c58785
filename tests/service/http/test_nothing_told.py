"""Responses reveal no libraries, paths or internal errors."""

from __future__ import annotations

import re
import socket
from collections.abc import Callable
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

from fastapi import FastAPI

import anchorflow_service

REQUESTS = [
    ("GET", "/", b""),
    ("GET", "/docs", b""),
    ("GET", "/redoc", b""),
    ("GET", "/metrics", b""),
    ("GET", "/nowhere/../etc/passwd", b""),
    ("GET", "/page/../../pyproject.toml", b""),
    ("DELETE", "/anchors", b""),
    ("POST", "/anchors", b"{"),
    ("POST", "/anchors", b"[1, 2, nonsense]"),
    ("POST", "/anchors", b"\xff\xfe"),
    ("POST", "/anchors", b'{"model": 7}'),
    ("GET", "/v2", b""),
    ("GET", "/v2/models", b""),
]
LIBRARIES = (
    "fastapi",
    "starlette",
    "uvicorn",
    "httptools",
    "h11",
    "orjson",
    "pydantic",
    "onnxruntime",
    "numpy",
)


def test_no_answer_names_a_library_or_a_place(service: Any) -> None:
    versions = [re.escape(each.version) for each in distributions() if each.name in LIBRARIES]
    place = re.escape(str(Path(anchorflow_service.__file__).parents[1]))
    betrayal = "|".join([r"Traceback|\bFile \"|site-packages|\.py\b", place, *versions])
    libraries = rf"\b({'|'.join(LIBRARIES)})\b"
    for method, path, body in REQUESTS:
        answer = service.request(method, path, content=body)
        said = "\n".join([*map(": ".join, answer.headers.items()), answer.text])
        assert not (found := re.search(betrayal, said)), (path, found)
        assert not (found := re.search(libraries, said, re.IGNORECASE)), (path, found)


def test_the_head_of_an_answer_names_no_server(app: FastAPI, serve: Callable[..., Any]) -> None:
    port = serve(app).port
    with socket.create_connection(("127.0.0.1", port)) as connection:
        connection.sendall(b"GET /v2 HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n")
        connection.settimeout(20)
        head = connection.recv(65536).partition(b"\r\n\r\n")[0].lower()

    assert head.startswith(b"http/1.1 200 ok")
    assert b"\r\nserver:" not in head
