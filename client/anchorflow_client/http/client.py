"""The client: asks a service for anchors over HTTP."""

from __future__ import annotations

from typing import Literal, TypeVar

from anchorflow_client.base_client import BaseClient
from anchorflow_client.codec import Codec
from anchorflow_client.contract import AnchorBatch, AnchorRequest, ModelCard
from anchorflow_client.http.exchange import UNHEALTHY, Exchange, Exchanges
from anchorflow_client.http.socket_transport import SocketTransport
from anchorflow_client.http.transport import Transport
from anchorflow_client.oip_codec import OipCodec
from anchorflow_client.patience import LONGEST_S, check_times

Result = TypeVar("Result")


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

        Raises:
            ValueError: the URL is none, a time is not above 0 or is over 10⁶ s, or no header can
                carry the token.
        """
        check_times(LONGEST_S, timeout_s=timeout_s, connect_timeout_s=connect_timeout_s)
        self._transport = transport or SocketTransport(url, connect_timeout_s=connect_timeout_s)
        self._exchanges = Exchanges(url, codec=codec or OipCodec(), token=token)
        self._timeout_s = float(timeout_s)

    def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        """Anchors for a request that was built before."""
        return self._carry_out(self._exchanges.plan(request))

    def models(self) -> tuple[ModelCard, ...]:
        """The cards of all bundles that are served."""
        return self._carry_out(self._exchanges.models())

    def live(self) -> bool:
        """Whether a service answers; False where nobody listens."""
        return self._is("live")

    def ready(self) -> bool:
        """Whether it takes requests now; False while it starts or stops, or nobody listens."""
        return self._is("ready")

    def close(self) -> None:
        """Close the connection."""
        self._transport.close()

    def _is(self, kind: Literal["live", "ready"]) -> bool:
        try:
            return self._carry_out(self._exchanges.health(kind))
        except UNHEALTHY:
            return False

    def _carry_out(self, exchange: Exchange[Result]) -> Result:
        return exchange.result(
            self._transport.send(
                exchange.method, exchange.path, exchange.headers, exchange.body, self._timeout_s
            )
        )
