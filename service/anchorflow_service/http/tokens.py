"""Bearer tokens: a file of them, and the middleware that checks them.

The file is read again when it changes. It has a line for each token; empty lines and lines that
begin with # are skipped:

    NAME  SCOPES  sha256:DIGEST
    robot-7  infer        sha256:6f1ed002ab5595859014ebf0951522d9…
    fleet    infer,admin  sha256:2c26b46b68ffc68ff99b453c1d304134…

The file holds no token, only SHA-256 digests in hex. A token is random and long, so a slow hash
would protect it no better and would cost every request milliseconds.
"""

from __future__ import annotations

import hashlib
import hmac
import logging
import re
import stat
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fastapi import FastAPI
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from anchorflow_client.errors import AnchorFlowError, Unauthorized
from anchorflow_service.http.openapi import reference
from anchorflow_service.http.responses import error_response
from anchorflow_service.http.schemas import ErrorBody

INFER, ADMIN = "infer", "admin"
SCOPES = (INFER, ADMIN)
PREFIX = "sha256:"
NAME = re.compile(r"[\w.@-]{1,64}")
HEX_DIGITS = 64
RELOAD_S = 1.0
"""Time between two checks of the file, so a removed token works no longer than this."""
HEALTH = "/v2/health/"
PUBLIC = frozenset()
"""Scopes of what needs no token: health, for probes, and the page's files."""

logger = logging.getLogger(__name__)


class TokenFileError(AnchorFlowError):
    """The token file cannot be read, or one of its lines is invalid."""


@dataclass(frozen=True)
class Token:
    """An entry of the file."""

    name: str
    """Whom it was given to, for the log."""
    scopes: frozenset[str]
    digest: bytes
    """SHA-256, 32 bytes."""


class TokenFile:
    """The tokens of a file, read again when the file changes.

    If the file becomes invalid while the service runs, the previous tokens stay and the log says
    why. An empty token file denies every request.

    Raises:
        TokenFileError: the file cannot be read, holds no token, or has an invalid line.
    """

    def __init__(self, path: Path, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._path = path
        self._clock = clock
        self._looked = clock()
        self._stamp = _stamp(path)
        self._tokens = read_tokens(path)
        if not self._tokens:
            raise TokenFileError(f"{path}: holds no token, so that nobody could ask anything")
        self._fault = ""
        """The last error, so that it is logged once."""

    def find(self, presented: str) -> Token | None:
        """Return the entry of a token that a caller presents, or None."""
        self._reload()
        digest = digest_of(presented)
        # Compare all, each in constant time, so that the duration reveals nothing.
        matches = [each for each in self._tokens if hmac.compare_digest(each.digest, digest)]
        return matches[0] if matches else None

    def _reload(self) -> None:
        now = self._clock()
        if now - self._looked < RELOAD_S:
            return
        self._looked = now
        stamp = _stamp(self._path)
        if stamp == self._stamp:
            return
        try:
            self._tokens = read_tokens(self._path)
        except TokenFileError as error:
            if str(error) != self._fault:
                logger.error("the tokens stay as they were: %s", error)
            self._fault = str(error)
            return
        self._stamp, self._fault = stamp, ""
        level = logging.INFO if self._tokens else logging.ERROR
        logger.log(level, "%d tokens read from %s", len(self._tokens), self._path)


def read_tokens(path: Path) -> tuple[Token, ...]:
    """Read the tokens of a file, which may hold none. Raises `TokenFileError`."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise TokenFileError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise TokenFileError(f"{path}: expected UTF-8 text") from error
    try:
        return tuple(_parse(text))
    except ValueError as error:
        raise TokenFileError(f"{path}: {error}") from error


def token_line(name: str, scopes: tuple[str, ...], token: str) -> str:
    """Return the file's line for a token. Raises `ValueError` if `read_tokens` would refuse it."""
    line = f"{name} {','.join(scopes)} {PREFIX}{digest_of(token).hex()}"
    _token(line)
    return line


def digest_of(token: str) -> bytes:
    """Return the SHA-256 digest, 32 bytes."""
    return hashlib.sha256(token.encode()).digest()


def _parse(text: str) -> Iterator[Token]:
    names: set[str] = set()
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            token = _token(line)
            if token.name in names:
                raise ValueError(f"the name {token.name} stands above already")
        except ValueError as error:
            raise ValueError(f"line {number}: {error}") from error
        names.add(token.name)
        yield token


def _token(line: str) -> Token:
    # The message repeats nothing of the line, which may hold a token by mistake.
    words = line.split()
    if len(words) != 3:
        raise ValueError(f"expected NAME SCOPES {PREFIX}DIGEST, got {len(words)} words")
    name, scopes, digest = words
    if not NAME.fullmatch(name):
        raise ValueError("expected a name of up to 64 letters, digits and . _ @ -")
    unknown = set(scopes.split(",")) - set(SCOPES)
    if unknown:
        raise ValueError(f"expected scopes among {','.join(SCOPES)}")
    hexadecimal = digest.removeprefix(PREFIX)
    if digest == hexadecimal or not re.fullmatch(rf"[0-9a-fA-F]{{{HEX_DIGITS}}}", hexadecimal):
        raise ValueError(f"expected {PREFIX} and {HEX_DIGITS} hexadecimal digits")
    return Token(name, frozenset(scopes.split(",")), bytes.fromhex(hexadecimal))


def _stamp(path: Path) -> tuple[int, ...] | None:
    """Return what changes with the file; None if it is missing or a pipe, which is read once."""
    try:
        status = path.stat()
    except OSError:
        return None
    if not stat.S_ISREG(status.st_mode):
        return None
    return status.st_mtime_ns, status.st_ctime_ns, status.st_size, status.st_ino


class TokenGuard:
    """Middleware: refuses requests without a token of the scope that their path needs.

    It keeps the name of the token in the request's `state.caller`.
    """

    def __init__(self, app: ASGIApp, *, tokens: TokenFile) -> None:
        self._app = app
        self._tokens = tokens

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, or respond `unauthorized`."""
        if scope["type"] == "http" and (needed := scopes_for(scope["method"], scope["path"])):
            try:
                token = self._token(Headers(scope=scope), needed)
            except Unauthorized as error:
                challenge = f'Bearer realm="anchorflow", scope="{" ".join(sorted(needed))}"'
                refused = error_response(error, {"WWW-Authenticate": challenge})
                await refused(scope, receive, send)
                return
            scope.setdefault("state", {})["caller"] = token.name
        await self._app(scope, receive, send)

    def _token(self, headers: Headers, needed: frozenset[str]) -> Token:
        scheme, _, presented = headers.get("authorization", "").partition(" ")
        if scheme.lower() != "bearer" or not presented.strip():
            raise Unauthorized("expected a bearer token, got none", "Authorization")
        token = self._tokens.find(presented.strip())
        if token is None:
            raise Unauthorized("expected a token that is valid here", "Authorization")
        if not token.scopes & needed:
            raise Unauthorized(
                f"expected a token with the scope {' or '.join(sorted(needed))}, "
                f"got {token.name} with {','.join(sorted(token.scopes))}",
                "Authorization",
            )
        return token


def scopes_for(method: str, path: str) -> frozenset[str]:
    """Return the scopes of which a caller needs one; empty if no token is needed.

    A path that is not named here needs `infer`, so a new route is closed by default.
    """
    if path.startswith(HEALTH) or path == "/":
        return PUBLIC
    if path.startswith("/page/") and method in ("GET", "HEAD"):
        return PUBLIC
    if path == "/v2/repository" or path.startswith("/v2/repository/"):
        return frozenset({ADMIN})
    return frozenset(SCOPES if path == "/metrics" else {INFER})


def document_tokens(app: FastAPI) -> None:
    """Add to the app's OpenAPI schema which routes need a token, and how they refuse."""
    schema = app.openapi()
    schemes = schema["components"].setdefault("securitySchemes", {})
    schemes["token"] = {"type": "http", "scheme": "bearer"}
    error = {"schema": reference(ErrorBody.__name__)}
    refused: dict[str, Any] = {
        "description": f"`{Unauthorized.code}`",
        "content": {"application/json": error},
    }
    for path, operations in schema["paths"].items():
        for method, operation in operations.items():
            if scopes_for(method.upper(), path):
                operation["security"] = [{"token": []}]
                operation["responses"][str(Unauthorized.http_status)] = refused
