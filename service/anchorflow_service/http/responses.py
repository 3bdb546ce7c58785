"""Responses in JSON, the contract's refusals, and work that ends when its client disconnects."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable, Coroutine, Mapping
from typing import Any, TypeVar

from fastapi import FastAPI
from fastapi.routing import APIRoute
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response
from starlette.routing import request_response
from starlette.types import Receive, Scope, Send

from anchorflow_client.errors import InvalidRequest, Overloaded, RequestError
from anchorflow_service.http.orjson_codec import dump
from anchorflow_service.observability.logs import CLIENT_DISCONNECTED

MAX_ECHOED = 100
"""Characters of a method and a path that a refusal repeats."""

Result = TypeVar("Result")


class PlainRoute(APIRoute):
    """A documented route whose endpoint takes the whole request and returns the response.

    It skips FastAPI's search for parameters and dependencies.
    """

    def __init__(self, path: str, endpoint: Callable[..., Any], **options: Any) -> None:
        super().__init__(path, endpoint, **options)
        self._respond = request_response(endpoint)

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Call the endpoint, or refuse another method as FastAPI does."""
        known = scope["method"] in (self.methods or ())
        await (self._respond if known else super().handle)(scope, receive, send)


def json_response(
    value: Any, *, status: int = 200, headers: Mapping[str, str] | None = None
) -> Response:
    """Encode plain types and numpy arrays as JSON."""
    return Response(dump(value), status, headers, media_type="application/json")


def error_response(error: RequestError, headers: Mapping[str, str] | None = None) -> Response:
    """Return the contract's error JSON, with Retry-After if the error knows it."""
    headers = dict(headers or {})
    if isinstance(error, Overloaded) and error.retry_after_s is not None:
        headers["Retry-After"] = f"{error.retry_after_s:.0f}"
    return json_response(error.to_dict(), status=error.http_status, headers=headers)


def install_error_handlers(app: FastAPI) -> None:
    """Answer refusals, unknown paths and wrong methods with the contract's error JSON."""
    app.add_exception_handler(RequestError, _refused)
    app.add_exception_handler(HTTPException, _not_routed)
    app.add_exception_handler(
        ClientDisconnect, lambda *_: Response(status_code=CLIENT_DISCONNECTED)
    )


async def cancel_on_disconnect(request: Request, work: Coroutine[Any, Any, Result]) -> Result:
    """Return the result of the work. Cancel it and raise `ClientDisconnect` if the client leaves.

    The request's body must have been read: the next message is then the disconnect. The current
    task does the work, which takes fewer passes of the event loop than a task of its own.
    """
    working = asyncio.current_task()
    assert working is not None
    was_cancelled = is_over = False

    def cancel(watching: asyncio.Future[None]) -> None:
        nonlocal was_cancelled
        # Once the work is over, this would cancel what the task does next.
        if not is_over and not watching.cancelled():
            was_cancelled = True
            working.cancel()

    watching = asyncio.ensure_future(_disconnect(request))
    watching.add_done_callback(cancel)
    try:
        return await work
    except asyncio.CancelledError:
        if not was_cancelled:
            raise
        if sys.version_info >= (3, 11):
            working.uncancel()
        raise ClientDisconnect from None
    finally:
        is_over = True
        watching.cancel()


async def _disconnect(request: Request) -> None:
    while (await request.receive())["type"] != "http.disconnect":
        pass


def _refused(_: Request, error: Exception) -> Response:
    assert isinstance(error, RequestError)
    return error_response(error)


def _not_routed(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    came = f"{request.method} {request.url.path}"[:MAX_ECHOED]
    expected = (error.headers or {}).get("Allow", "one of the paths in /openapi.json")
    message = f"{error.detail}: expected {expected}, got {came}"
    return error_response(InvalidRequest(message, http_status=error.status_code), error.headers)
