"""A request's body, read no further than the limit."""

from __future__ import annotations

from starlette.requests import Request

from anchorflow_client.errors import TooLarge


async def read_body(request: Request, max_bytes: int) -> bytes:
    """The whole body.

    Raises:
        TooLarge: by its Content-Length before a byte is read, or as soon as more has come.
    """
    declared = request.headers.get("content-length", "")
    if declared.isdecimal() and int(declared) > max_bytes:
        raise _too_large(max_bytes, f"{int(declared)}")
    chunks, size = [], 0
    async for chunk in request.stream():
        size += len(chunk)
        if size > max_bytes:
            raise _too_large(max_bytes, "more")
        chunks.append(chunk)
    return b"".join(chunks)


def _too_large(max_bytes: int, came: str) -> TooLarge:
    return TooLarge(f"expected a body of at most {max_bytes} bytes, got {came}", "body")
