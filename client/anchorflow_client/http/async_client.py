"""The async client: asks a service for anchors over HTTP from an event loop."""

from __future__ import annotations

from typing import Literal, TypeVar

from anchorflow_client.base_client import BaseAsyncClient
from anchorflow_client.codec import Codec
from anchorflow_client.contract import AnchorBatch, AnchorRequest, ModelCard
from anchorflow_client.http.exchange import UNHEALTHY, Exchange, Exchanges
from anchorflow_client.http.transport import AsyncTransport
from anchorflow_client.oip_codec import OipCodec
from anchorflow_client.patience import LONGEST_S, check_times

Result = TypeVar("Result")


class AsyncAnchorClient(BaseAsyncClient):
    """A service at a URL, over a connection for each request on its way; they are kept alive.

        async with AsyncAnchorClient("http://127.0.0.1:8000") as client:
            asked = [client.plan(**scene, x_goal=goal) for goal in goals]
            for anchors in await asyncio.gather(*asked):
                path = anchors.trajectories[anchors.best]

    Where the task that awaits an answer is cancelled, its connection closes, and the service drops
    the request. Errors are those of `AnchorClient`.
    """

    def __init__(
        self,
        url: str,
        *,
        timeout_s: float = 30.0,
        connect_timeout_s: float = 5.0,
        max_connections: int = 64,
        token: str | None = None,
        transport: AsyncTransport | None = None,
        codec: Codec | None = None,
    ) -> None:
        """Opens no connection yet.

        Args:
            url: where the service listens, such as http://127.0.0.1:8000.
            timeout_s: longest wait for the service's next bytes.
            connect_timeout_s: longest wait for a connection.
            max_connections: requests on their way at the same time; others wait for a place, and
                their times begin when they have one.
            token: sent as a bearer token.
            transport: carries the requests in place of sockets.
            codec: the form on the wire: binary unless told, `JsonCodec()` to read along.

        Raises:
            ValueError: the URL is none, a time is not above 0 or is over 10⁶ s, or no header can
                carry the token.
        """
        check_times(LONGEST_S, timeout_s=timeout_s, connect_timeout_s=connect_timeout_s)
        if transport is None:
            # Here, so that a blocking robot's `import anchorflow_client` does not load asyncio.
            from anchorflow_client.http.async_socket_transport import AsyncSocketTransport

            transport = AsyncSocketTransport(
                url, connect_timeout_s=connect_timeout_s, max_connections=max_connections
            )
        self._transport = transport
        self._exchanges = Exchanges(url, codec=codec or OipCodec(), token=token)
        self._timeout_s = float(timeout_s)

    async def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        """Anchors for a request that was built before."""
        return await self._carry_out(self._exchanges.plan(request))

    async def models(self) -> tuple[ModelCard, ...]:
        """The cards of all bundles that are served."""
        return await self._carry_out(self._exchanges.models())

    async def live(self) -> bool:
        """Whether a service answers; False where nobody listens."""
        return await self._is("live")

    async def ready(self) -> bool:
        """Whether it takes requests now; False while it starts or stops, or nobody listens."""
        return await self._is("ready")

    async def aclose(self) -> None:
        """Close the connections; requests on their way fail."""
        await self._transport.aclose()

    async def _is(self, kind: Literal["live", "ready"]) -> bool:
        try:
            return await self._carry_out(self._exchanges.health(kind))
        except UNHEALTHY:
            return False

    async def _carry_out(self, exchange: Exchange[Result]) -> Result:
        return exchange.result(
            await self._transport.send(
                exchange.method, exchange.path, exchange.headers, exchange.body, self._timeout_s
            )
        )
