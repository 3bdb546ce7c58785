"""The clients over HTTP, blocking and async, around the same exchanges.

Both build requests and read answers with `Exchanges`; a transport only moves the bytes.
"""

from __future__ import annotations

from typing import Literal, TypeVar

from anchorflow_client.base_client import BaseAsyncClient, BaseClient
from anchorflow_client.codec import Codec
from anchorflow_client.contract import AnchorBatch, AnchorRequest, ModelCard
from anchorflow_client.http.exchange import UNHEALTHY, Exchange, Exchanges
from anchorflow_client.http.transport import AsyncTransport, SocketTransport, Transport
from anchorflow_client.oip_codec import OipCodec
from anchorflow_client.retry_policy import MAX_WAIT_S, check_times

Result = TypeVar("Result")


class AnchorClient(BaseClient):
    """A service at a URL, over one connection that is kept alive.

    with AnchorClient("http://127.0.0.1:8000") as client:
        anchors = client.plan(cost_map=occupancy, resolution=0.1, x_curr=state, x_goal=goal)
        path = anchors.trajectories[anchors.best]
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
        """Check the arguments; the first request opens the connection.

        Args:
            url: the service's address, such as http://127.0.0.1:8000.
            timeout_s: longest wait for the service's next bytes.
            connect_timeout_s: longest wait for a connection.
            token: sent as a bearer token.
            transport: carries the requests in place of a socket.
            codec: the form on the wire: binary by default, `JsonCodec()` for readable bodies.

        Raises:
            ValueError: the URL is invalid, a time is not above 0 or is over 10⁶ s, or the token
                cannot be sent in a header.
        """
        check_times(MAX_WAIT_S, timeout_s=timeout_s, connect_timeout_s=connect_timeout_s)
        self._transport = transport or SocketTransport(url, connect_timeout_s=connect_timeout_s)
        self._exchanges = Exchanges(url, codec=codec or OipCodec(), token=token)
        self._timeout_s = float(timeout_s)

    def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        return self._send(self._exchanges.plan(request))

    def models(self) -> tuple[ModelCard, ...]:
        return self._send(self._exchanges.models())

    def live(self) -> bool:
        return self._health("live")

    def ready(self) -> bool:
        return self._health("ready")

    def close(self) -> None:
        self._transport.close()

    def _health(self, kind: Literal["live", "ready"]) -> bool:
        try:
            return self._send(self._exchanges.health(kind))
        except UNHEALTHY:
            return False

    def _send(self, exchange: Exchange[Result]) -> Result:
        return exchange.result(self._transport.send(*exchange.request, self._timeout_s))


class AsyncAnchorClient(BaseAsyncClient):
    """A service at a URL, over one kept-alive connection for each concurrent request.

        async with AsyncAnchorClient("http://127.0.0.1:8000") as client:
            requests = [client.plan(**scene, x_goal=goal) for goal in goals]
            for anchors in await asyncio.gather(*requests):
                path = anchors.trajectories[anchors.best]

    Cancelling the task that awaits an answer closes its connection, and the service drops the
    request. Errors are those of `AnchorClient`.
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
        """Check the arguments; requests open the connections.

        Args:
            max_connections: concurrent requests; further ones wait for a free connection, and
                their timeouts begin after that wait.

        Other arguments, and errors: see `AnchorClient`.
        """
        check_times(MAX_WAIT_S, timeout_s=timeout_s, connect_timeout_s=connect_timeout_s)
        if transport is None:
            # Here, so that a blocking robot's `import anchorflow_client` does not load asyncio.
            from anchorflow_client.http.async_transport import AsyncSocketTransport

            transport = AsyncSocketTransport(
                url, connect_timeout_s=connect_timeout_s, max_connections=max_connections
            )
        self._transport = transport
        self._exchanges = Exchanges(url, codec=codec or OipCodec(), token=token)
        self._timeout_s = float(timeout_s)

    async def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        return await self._send(self._exchanges.plan(request))

    async def models(self) -> tuple[ModelCard, ...]:
        return await self._send(self._exchanges.models())

    async def live(self) -> bool:
        return await self._health("live")

    async def ready(self) -> bool:
        return await self._health("ready")

    async def aclose(self) -> None:
        await self._transport.aclose()

    async def _health(self, kind: Literal["live", "ready"]) -> bool:
        try:
            return await self._send(self._exchanges.health(kind))
        except UNHEALTHY:
            return False

    async def _send(self, exchange: Exchange[Result]) -> Result:
        return exchange.result(await self._transport.send(*exchange.request, self._timeout_s))
