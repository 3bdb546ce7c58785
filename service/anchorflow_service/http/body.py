"""Read a request's body, up to a limit."""

from __future__ import annotations

import asyncio
from contextlib import suppress

from starlette.requests import ClientDisconnect, Request

from anchorflow_client.errors import InvalidRequest, TooLarge

# Most clients send the whole body before they read the answer; if the connection closed in between,
# they would see a reset instead of the reason. So the rest is received and discarded.
MAX_DISCARDED_BYTES = 256 * 2**20
MAX_DISCARDING_S = 10.0


async def read_body(request: Request, max_bytes: int) -> bytes:
    """Read the whole body.

    Raises:
        InvalidRequest: it is compressed; a small body could unpack to a huge one.
        TooLarge: by its Content-Length, or as soon as it grows beyond; the rest is discarded.
    """
    encoding = request.headers.get("content-encoding", "identity")
    if encoding.lower() != "identity":
        await discard_body(request)
        raise InvalidRequest(f"expected a body as it is, got {encoding[:40]!r}", "Content-Encoding")
    declared = request.headers.get("content-length", "")
    if declared.isdecimal() and int(declared) > max_bytes:
        await discard_body(request)
        raise _too_large(max_bytes, f"{int(declared)}")
    chunks, size = [], 0
    async for chunk in request.stream():
        size += len(chunk)
        if size > max_bytes:
            chunks.clear()
            await discard_body(request)
            raise _too_large(max_bytes, "more")
        chunks.append(chunk)
    return b"".join(chunks)


async def discard_body(request: Request) -> None:
    """Receive and discard the rest of a body, within bounds of size and time."""

    async def take() -> None:
        size = 0
        async for chunk in request.stream():
            size += len(chunk)
            if size > MAX_DISCARDED_BYTES:
                return

    with suppress(asyncio.TimeoutError, ClientDisconnect):
        await asyncio.wait_for(take(), MAX_DISCARDING_S)


def _too_large(max_bytes: int, came: str) -> TooLarge:
    return TooLarge(f"expected a body of at most {max_bytes} bytes, got {came}", "body")
