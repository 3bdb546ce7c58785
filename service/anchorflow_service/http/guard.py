"""Who may ask for what: the one place where paths meet the scopes of tokens."""

from __future__ import annotations

from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from anchorflow_client.errors import Unauthorized
from anchorflow_service.http.body import discard_body
from anchorflow_service.http.errors import error_answer
from anchorflow_service.http.tokens import ADMIN, INFER, SCOPES, Token, TokenFile

HEALTH = "/v2/health/"
OPEN_TO_ALL = frozenset()
"""Health, so that a probe needs no token, and the page's files, which every installation has."""


def scopes_for(method: str, path: str) -> frozenset[str]:
    """The scopes of which a caller needs one; none where everybody may.

    Whatever is not named here needs a token: a route that somebody adds is closed until it is.
    """
    if path.startswith(HEALTH) or path == "/":
        return OPEN_TO_ALL
    if path.startswith("/page/") and method in ("GET", "HEAD"):
        return OPEN_TO_ALL
    if path == "/v2/repository" or path.startswith("/v2/repository/"):
        return frozenset({ADMIN})
    if path == "/metrics":
        return frozenset(SCOPES)
    return frozenset({INFER})


class Guard:
    """Middleware: refuses whoever shows no token with the scope that the path needs.

    The name of the token stands in the request's `state.caller`.
    """

    def __init__(self, app: ASGIApp, *, tokens: TokenFile) -> None:
        self._app = app
        self._tokens = tokens

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, or answer `unauthorized`."""
        if scope["type"] == "http":
            needed = scopes_for(scope["method"], scope["path"])
            if needed:
                try:
                    token = self._token(Headers(scope=scope), needed)
                except Unauthorized as error:
                    await discard_body(Request(scope, receive))
                    challenge = {"WWW-Authenticate": _challenge(needed)}
                    await error_answer(error, challenge)(scope, receive, send)
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
                f"expected a token with the scope {_either(needed)}, "
                f"got {token.name} with {','.join(sorted(token.scopes))}",
                "Authorization",
            )
        return token


def _challenge(needed: frozenset[str]) -> str:
    return f'Bearer realm="anchorflow", scope="{" ".join(sorted(needed))}"'


def _either(scopes: frozenset[str]) -> str:
    return " or ".join(sorted(scopes))
