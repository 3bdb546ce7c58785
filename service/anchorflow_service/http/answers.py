"""Answers in JSON."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from starlette.responses import Response

from anchorflow_service.http.orjson_codec import dump


def json_answer(
    value: Any, *, status: int = 200, headers: Mapping[str, str] | None = None
) -> Response:
    """A response of plain types and numpy arrays."""
    return Response(dump(value), status, headers, media_type="application/json")
