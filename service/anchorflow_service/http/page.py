"""The page at `/`: files that ship inside the package, and the flow that its replay shows.

No file is looked up by what a caller sends: all are read when the routes are made.
"""

from __future__ import annotations

import gzip
import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from anchorflow_service.http.flow_replay import flow_replay_router
from anchorflow_service.planning import PlanningService

FOLDER = Path(__file__).parents[1] / "page"
INDEX = "index.html"

CONTENT_TYPES = {
    ".css": "text/css; charset=utf-8",
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
HEADERS = {
    # Nothing from elsewhere, nothing inline, in nobody's frame.
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    # Kept by the browser, asked after at every load: modules of two versions must not meet.
    "Cache-Control": "no-cache",
    "Vary": "Accept-Encoding",
}


@dataclass(frozen=True)
class PageFile:
    """A file as it is sent."""

    content_type: str
    body: bytes
    zipped: bytes
    tag: str
    """Weak, because it stands for the file in either encoding."""

    @classmethod
    def of(cls, path: Path) -> PageFile:
        """Read it."""
        body = path.read_bytes()
        return cls(
            content_type=CONTENT_TYPES[path.suffix],
            body=body,
            zipped=gzip.compress(body, mtime=0),
            tag=f'W/"{hashlib.sha256(body).hexdigest()[:20]}"',
        )

    def answer(self, request: Request) -> Response:
        """The file, or 304 where the browser has it."""
        headers = {**HEADERS, "ETag": self.tag}
        if self.tag in request.headers.get("if-none-match", ""):
            return Response(status_code=304, headers=headers)
        zips = "gzip" in request.headers.get("accept-encoding", "")
        if zips:
            headers["Content-Encoding"] = "gzip"
        body = self.zipped if zips else self.body
        return Response(body, headers=headers, media_type=self.content_type)


def page_router(service: PlanningService) -> APIRouter:
    """`/`, `/page/…` and what the page alone asks of the service."""
    router = APIRouter(include_in_schema=False)
    for url, path in page_files():
        endpoint = partial(_answer, PageFile.of(path))
        router.add_api_route(url, endpoint, methods=["GET", "HEAD"], name=path.name)
    router.include_router(flow_replay_router(service))
    return router


def page_files() -> Iterator[tuple[str, Path]]:
    """The URL and the place of every file of the page."""
    yield "/", FOLDER / INDEX
    for path in sorted(FOLDER.rglob("*.*")):
        if path.suffix in CONTENT_TYPES and path.name != INDEX:
            yield f"/page/{path.relative_to(FOLDER).as_posix()}", path


async def _answer(file: PageFile, request: Request) -> Response:
    return file.answer(request)
