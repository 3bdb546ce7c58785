"""What a client sends over HTTP, and what the answers mean. Knows no socket."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Generic, Literal, TypeVar
from urllib.parse import urlsplit

from anchorflow_client.codec import Codec, Payload, answer_to
from anchorflow_client.contract import AnchorBatch, AnchorRequest, ModelCard
from anchorflow_client.errors import (
    ConnectionFailed,
    InvalidAnswer,
    InvalidRequest,
    NotReady,
    RequestError,
    TimedOut,
)
from anchorflow_client.http.transport import HttpAnswer
from anchorflow_client.http.whole_number import whole_number
from anchorflow_client.json_codec import parse
from anchorflow_client.wire_fields import UNREADABLE

Result = TypeVar("Result")

UNHEALTHY = (NotReady, ConnectionFailed, TimedOut)
"""What asking for health meets where the answer is no."""
PROXY_STATUSES = frozenset({500, 502, 503, 504})
"""With which a proxy says that it does not reach the service; 501 is another program's."""


@dataclass(frozen=True)
class Exchange(Generic[Result]):
    """A request, and the way to read its answer."""

    method: str
    path: str
    headers: Mapping[str, str]
    body: bytes | None
    read: Callable[[Payload], Result]
    """Of an answer of status 200. Raises `InvalidAnswer`."""

    def result(self, answer: HttpAnswer) -> Result:
        """What the service says.

        Raises:
            RequestError: it refuses.
            ConnectionFailed: a proxy answers, which has no way to it.
            InvalidAnswer: what came is not the contract's.
        """
        status, headers, body = answer
        if status != 200:
            raise _refusal(status, headers, body)
        length = whole_number(headers.get("inference-header-content-length"))
        return self.read(Payload(body, length))


class Exchanges:
    """All that a service can be asked."""

    def __init__(self, url: str, *, codec: Codec, token: str | None) -> None:
        """For a service at a URL, whose path stands before every path of the contract.

        Raises:
            ValueError: no header can carry the token; what it is is not repeated.
        """
        if token is not None and not (token.isascii() and token.isprintable()):
            raise ValueError("token: expected printable ASCII, got other characters too")
        self._codec = codec
        self._base_path = urlsplit(url).path.rstrip("/")
        self._authorization = {} if token is None else {"Authorization": f"Bearer {token}"}

    def plan(self, request: AnchorRequest) -> Exchange[AnchorBatch]:
        """Anchors, in the codec's form."""
        payload = self._codec.encode_request(request)
        form = self._codec.content_type
        headers = {"Accept": form, **self._authorization, "Content-Type": form}
        if payload.header_length is not None:
            headers["Inference-Header-Content-Length"] = str(payload.header_length)
        path = f"{self._base_path}/anchors"

        def read(answer: Payload) -> AnchorBatch:
            return answer_to(request, self._codec.decode_answer(answer))

        return Exchange("POST", path, headers, payload.body, read)

    def models(self) -> Exchange[tuple[ModelCard, ...]]:
        """The cards of all bundles that are served, the default first."""
        return self._get("/v2/models", _cards)

    def health(self, kind: Literal["live", "ready"]) -> Exchange[bool]:
        """True; where the answer is no, one of `UNHEALTHY` is met."""
        return self._get(f"/v2/health/{kind}", lambda _: True)

    def _get(self, path: str, read: Callable[[Payload], Result]) -> Exchange[Result]:
        headers = {"Accept": "application/json", **self._authorization}
        return Exchange("GET", self._base_path + path, headers, None, read)


def _cards(answer: Payload) -> tuple[ModelCard, ...]:
    try:
        return tuple(map(ModelCard.from_dict, parse(answer.body)["models"]))
    except (*UNREADABLE, InvalidRequest) as error:
        raise InvalidAnswer(f"not a list of model cards: {error!r}") from error


def _refusal(status: int, headers: Mapping[str, str], body: bytes) -> RequestError:
    """The service's own words.

    Raises:
        ConnectionFailed: they are those of a proxy, which has no way to the service.
        InvalidAnswer: they are not the contract's in another way.
    """
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
