"""A route that FastAPI documents, and for which it does nothing else."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from fastapi.routing import APIRoute
from starlette.routing import request_response
from starlette.types import Receive, Scope, Send


class PlainRoute(APIRoute):
    """Hands a request to its endpoint, which takes it whole and gives the response.

    FastAPI would look for parameters and dependencies first, of which such an endpoint has none.
    """

    def __init__(self, path: str, endpoint: Callable[..., Any], **options: Any) -> None:
        super().__init__(path, endpoint, **options)
        self._answer = request_response(endpoint)

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, or refuse another method as FastAPI does."""
        known = scope["method"] in (self.methods or ())
        await (self._answer if known else super().handle)(scope, receive, send)
