"""Every refusal and every failure leaves as the contract's error JSON."""

from __future__ import annotations

from collections.abc import Mapping

from fastapi import FastAPI
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response

from anchorflow_client.errors import InvalidRequest, Overloaded, RequestError
from anchorflow_service.http.answers import json_answer
from anchorflow_service.http.hang_up import to_nobody

MAX_ECHOED = 100
"""Characters of a method and a path that a refusal repeats."""


def install_error_handlers(app: FastAPI) -> None:
    """Answer refusals, unknown paths and wrong methods in the contract's words."""
    app.add_exception_handler(RequestError, _refused)
    app.add_exception_handler(HTTPException, _not_routed)
    app.add_exception_handler(ClientDisconnect, _broken_off)


def error_answer(error: RequestError, headers: Mapping[str, str] | None = None) -> Response:
    """The error JSON, with Retry-After where the error knows it."""
    headers = dict(headers or {})
    if isinstance(error, Overloaded) and error.retry_after_s is not None:
        headers["Retry-After"] = f"{error.retry_after_s:.0f}"
    return json_answer(error.to_dict(), status=error.http_status, headers=headers)


def _refused(_: Request, error: Exception) -> Response:
    assert isinstance(error, RequestError)
    return error_answer(error)


def _not_routed(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    came = f"{request.method} {request.url.path}"[:MAX_ECHOED]
    expected = (error.headers or {}).get("Allow", "one of the paths in /openapi.json")
    message = f"{error.detail}: expected {expected}, got {came}"
    return error_answer(InvalidRequest(message, http_status=error.status_code), error.headers)


def _broken_off(_: Request, __: Exception) -> Response:
    return to_nobody()
