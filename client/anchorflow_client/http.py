"""The client: asks a service for anchors over HTTP."""

from __future__ import annotations

import json
from collections.abc import Mapping
from urllib.parse import urlsplit

from anchorflow_client.base_client import BaseClient
from anchorflow_client.codec import Codec, Payload
from anchorflow_client.contract import AnchorBatch, AnchorRequest, ModelCard
from anchorflow_client.errors import (
    ConnectionFailed,
    InvalidAnswer,
    NotReady,
    RequestError,
    TimedOut,
)
from anchorflow_client.oip_codec import OipCodec
from anchorflow_client.transport import SocketTransport, Transport

MAX_DIGITS = 18
"""Of a number in a header, which fits 64 bits."""
PROXY_STATUSES = frozenset({500, 502, 503, 504})
"""With which a proxy says that it does not reach the service; 501 is another program's."""


class AnchorClient(BaseClient):
    """A service at a URL, over one connection that is kept alive.

        with AnchorClient("http://127.0.0.1:8000") as client:
            anchors = client.plan(cost_map=occupancy, resolution=0.1, x_curr=state, x_goal=goal)
            path = anchors.trajectories[anchors.best]

    Every method raises a `RequestError` where the service refuses and a `TransportError` where no
    answer of the contract comes; see `anchorflow_client.errors`.
    """

    def __init__(
        self,
        url: str,
        *,
        timeout_s: float = 30.0,
        connect_timeout_s: float = 5.0,
        token: str | None = None,
        transport: Transport | None = None,
        codec: Codec | None = None,
    ) -> None:
        """Opens no connection yet.

        Args:
            url: where the service listens, such as http://127.0.0.1:8000.
            timeout_s: longest wait for the service's next bytes.
            connect_timeout_s: longest wait for a connection.
            token: sent as a bearer token.
            transport: carries the requests in place of a socket.
            codec: the form on the wire: binary unless told, `JsonCodec()` to read along.
        """
        self._transport = transport or SocketTransport(url, connect_timeout_s=connect_timeout_s)
        self._codec = codec or OipCodec()
        self._timeout_s = timeout_s
        self._base_path = urlsplit(url).path.rstrip("/")
        self._headers = {"Accept": self._codec.content_type}
        if token is not None:
            self._headers["Authorization"] = f"Bearer {token}"

    def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        """Anchors for a request that was built before."""
        payload = self._codec.encode_request(request)
        headers = {"Content-Type": self._codec.content_type}
        if payload.header_length is not None:
            headers["Inference-Header-Content-Length"] = str(payload.header_length)
        return self._codec.decode_answer(self._send("POST", "/anchors", headers, payload.body))

    def models(self) -> tuple[ModelCard, ...]:
        """The cards of all bundles that are served."""
        answer = self._send("GET", "/v2/models", {"Accept": "application/json"})
        try:
            return tuple(map(ModelCard.from_dict, json.loads(answer.body)["models"]))
        except (ValueError, TypeError, KeyError) as error:
            raise InvalidAnswer(f"not a list of model cards: {error!r}") from error

    def live(self) -> bool:
        """Whether a service answers; False where nobody listens."""
        return self._is_healthy("/v2/health/live")

    def ready(self) -> bool:
        """Whether it takes requests now; False while it starts or stops, or nobody listens."""
        return self._is_healthy("/v2/health/ready")

    def close(self) -> None:
        """Close the connection."""
        self._transport.close()

    def _is_healthy(self, path: str) -> bool:
        try:
            self._send("GET", path, {"Accept": "application/json"})
        except (NotReady, ConnectionFailed, TimedOut):
            return False
        return True

    def _send(
        self, method: str, path: str, headers: Mapping[str, str], body: bytes | None = None
    ) -> Payload:
        status, answer_headers, answer = self._transport.send(
            method, self._base_path + path, self._headers | dict(headers), body, self._timeout_s
        )
        if status != 200:
            raise _refusal(status, answer_headers, answer)
        return Payload(answer, _whole_number(answer_headers.get("inference-header-content-length")))


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
            retry_after_s=_whole_number(headers.get("retry-after")),
        )
    except (ValueError, InvalidAnswer) as error:
        if status in PROXY_STATUSES:
            proxy = f"status {status}, not in the service's own words: a proxy before it answers"
            raise ConnectionFailed(proxy) from error
        raise InvalidAnswer(f"status {status} without the contract's error JSON") from error


def _whole_number(header: str | None) -> int | None:
    """The number in a header; None where there is none, or a date as Retry-After may hold."""
    return int(header) if header and header.isdecimal() and len(header) <= MAX_DIGITS else None
