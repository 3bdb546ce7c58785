"""Requests to send over HTTP, and how to read their answers. Does no I/O."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Generic, Literal, TypeVar
from urllib.parse import urlsplit

from anchorflow_client.codec import UNREADABLE, Codec, Payload, answer_to, parse
from anchorflow_client.contract import AnchorBatch, AnchorRequest, ModelCard
from anchorflow_client.errors import (
    ConnectionFailed,
    InvalidAnswer,
    InvalidRequest,
    NotReady,
    RequestError,
    TimedOut,
    UsageError,
)
from anchorflow_client.http.answer_parser import HttpAnswer, whole_number

Result = TypeVar("Result")

UNHEALTHY = (NotReady, ConnectionFailed, TimedOut)
"""Errors of a health request that mean "no"."""
PROXY_STATUSES = frozenset({500, 502, 503, 504})
"""Statuses of a proxy that cannot reach the service; a 501 is from another program."""


@dataclass(frozen=True)
class Exchange(Generic[Result]):
    """A request, and the function that reads its answer."""

    request: tuple[str, str, Mapping[str, str], bytes | None]
    """Method, path, headers and body, the first arguments of a transport's `send`."""
    read: Callable[[Payload], Result]
    """Reads an answer of status 200. Raises `InvalidAnswer`."""

    def result(self, answer: HttpAnswer) -> Result:
        """Read the answer. Raises `RequestError`, `ConnectionFailed` or `InvalidAnswer`."""
        status, headers, body = answer
        if status != 200:
            raise _refusal(status, headers, body)
        length = whole_number(headers.get("inference-header-content-length"))
        return self.read(Payload(body, length))


class Exchanges:
    """All requests that a service answers."""

    def __init__(self, url: str, *, codec: Codec, token: str | None) -> None:
        """Keep the URL's path. Raises `UsageError`, which does not repeat the token."""
        if token is not None and not (token.isascii() and token.isprintable()):
            raise UsageError("token: expected printable ASCII, got other characters too")
        self._codec = codec
        self._base_path = urlsplit(url).path.rstrip("/")
        self._authorization = {} if token is None else {"Authorization": f"Bearer {token}"}

    def plan(self, request: AnchorRequest) -> Exchange[AnchorBatch]:
        payload = self._codec.encode_request(request)
        forms = {"Accept": self._codec.accept, "Content-Type": self._codec.content_type}
        headers = {**forms, **self._authorization}
        if payload.header_length is not None:
            headers["Inference-Header-Content-Length"] = str(payload.header_length)

        def read(answer: Payload) -> AnchorBatch:
            return answer_to(request, self._codec.decode_answer(answer))

        return Exchange(("POST", f"{self._base_path}/anchors", headers, payload.body), read)

    def models(self) -> Exchange[tuple[ModelCard, ...]]:
        return self._get("/v2/models", _read_cards)

    def health(self, kind: Literal["live", "ready"]) -> Exchange[bool]:
        """Request the service's health: the result is True, or one of `UNHEALTHY` is raised."""
        return self._get(f"/v2/health/{kind}", lambda _: True)

    def _get(self, path: str, read: Callable[[Payload], Result]) -> Exchange[Result]:
        headers = {"Accept": "application/json", **self._authorization}
        return Exchange(("GET", self._base_path + path, headers, None), read)


def _read_cards(answer: Payload) -> tuple[ModelCard, ...]:
    try:
        return tuple(map(ModelCard.from_dict, parse(answer.body)["models"]))
    except (*UNREADABLE, InvalidRequest) as error:
        raise InvalidAnswer(f"not a list of model cards: {error!r}") from error


def _refusal(status: int, headers: Mapping[str, str], body: bytes) -> RequestError:
    """Return the service's error. Raises as `Exchange.result` if the JSON is not the contract's."""
    try:
        return RequestError.from_dict(
            json.loads(body),
            http_status=status,
            retry_after_s=whole_number(headers.get("retry-after")),
        )
    except (ValueError, RecursionError, InvalidAnswer) as error:
        if status in PROXY_STATUSES:
            proxy = f"status {status}, not in the service's own words: a proxy before it answers"
            raise ConnectionFailed(proxy) from error
        raise InvalidAnswer(f"status {status} without the contract's error JSON") from error
