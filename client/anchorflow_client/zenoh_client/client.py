"""The clients over zenoh: a blocking one, and an async one that runs it on threads."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import TypeVar

from anchorflow_client.base_client import BaseAsyncClient, BaseClient
from anchorflow_client.cancellation import Cancellation, Deadline
from anchorflow_client.codec import answer_to
from anchorflow_client.contract import AnchorBatch, AnchorRequest, ModelCard
from anchorflow_client.errors import Cancelled, ConnectionFailed, TimedOut
from anchorflow_client.oip_codec import OipCodec
from anchorflow_client.retry_policy import MAX_WAIT_S, check_times
from anchorflow_client.zenoh_client.failover import EncodedRequest, Failover
from anchorflow_client.zenoh_client.network import Connection, Network
from anchorflow_client.zenoh_client.session import ZenohSettings
from anchorflow_client.zenoh_messages import ReplicaInfo

Result = TypeVar("Result")


class ZenohAnchorClient(BaseClient):
    """The replicas of a service on a zenoh network; threads may share it.

        with ZenohAnchorClient("tcp/127.0.0.1:7447") as client:
            anchors = client.plan(
                cost_map=occupancy, resolution=0.1, x_curr=state, x_goal=goal, budget_ms=80
            )

    A request is sent to the replica with the shortest expected time, by the load that replicas
    report. If that replica dies or is overloaded, another is queried within the same time.

    Errors:
        ConnectionFailed: there is no router or no service, or TLS fails.
        Unauthorized: the user or password is wrong, or access control denies the key.
        TimedOut: no answer arrived within `budget_ms`, or `timeout_s` without one; or a service is
            alive and does not answer.
        Cancelled: the request was cancelled, or the client was closed meanwhile.
        InvalidAnswer: the answer breaks the contract.
        RequestError: the service refuses, with the same errors as over HTTP.
    """

    def __init__(
        self,
        where: str | Sequence[str] | ZenohSettings,
        *,
        timeout_s: float = 30.0,
    ) -> None:
        """Check the arguments; the first call connects.

        Args:
            where: endpoints to connect to, such as tcp/127.0.0.1:7447, or settings.
            timeout_s: longest wait for an answer, and the budget that is sent to the service, if
                the request has none.

        Raises:
            ValueError: `timeout_s` is not above 0, or over 10⁶ s.
        """
        check_times(MAX_WAIT_S, timeout_s=timeout_s)
        if not isinstance(where, ZenohSettings):
            endpoints = (where,) if isinstance(where, str) else tuple(where)
            where = ZenohSettings(mode="client", connect=endpoints)
        self._connection = Connection(where)
        self._timeout_s = float(timeout_s)
        self._codec = OipCodec()
        self._closing = Cancellation()

    def plan_request(
        self, request: AnchorRequest, *, cancellation: Cancellation | None = None
    ) -> AnchorBatch:
        """Return anchors for a request that was built before.

        Args:
            request: its `budget_ms` bounds the whole call, connecting and failover included.
            cancellation: cancels the request, from any thread.
        """
        deadline = self._deadline(cancellation, request.budget_ms)
        encoded = EncodedRequest(
            payload=self._codec.encode_request(request),
            content_type=self._codec.content_type,
            request_id=request.request_id or uuid.uuid4().hex,
            model=request.model,
            deadline=deadline,
        )
        payload = Failover(self._settled(deadline), encoded).run()
        return answer_to(request, self._codec.decode_answer(payload))

    def models(self, *, cancellation: Cancellation | None = None) -> tuple[ModelCard, ...]:
        cards: dict[str, ModelCard] = {}
        for info in self._infos(cancellation):
            for card in info.models:
                cards.setdefault(card.name, card)
        return tuple(cards.values())

    def live(self, *, cancellation: Cancellation | None = None) -> bool:
        try:
            network = self._settled(self._deadline(cancellation))
        except (ConnectionFailed, TimedOut, Cancelled):
            return False
        return bool(network.replicas.alive())

    def ready(self, *, cancellation: Cancellation | None = None) -> bool:
        try:
            return any(info.ready for info in self._infos(cancellation))
        except (ConnectionFailed, TimedOut, Cancelled):
            return False

    def close(self) -> None:
        self._closing.cancel()
        self._connection.close()

    def _deadline(
        self, cancellation: Cancellation | None, budget_ms: float | None = None
    ) -> Deadline:
        timeout_s = self._timeout_s if budget_ms is None else budget_ms / 1e3
        own = () if cancellation is None else (cancellation,)
        return Deadline(timeout_s, self._closing, *own)

    def _settled(self, deadline: Deadline) -> Network:
        network = self._connection.network(deadline)
        network.settle(deadline)
        return network

    def _infos(self, cancellation: Cancellation | None) -> list[ReplicaInfo]:
        deadline = self._deadline(cancellation)
        return self._connection.network(deadline).infos(deadline)


class AsyncZenohAnchorClient(BaseAsyncClient):
    """`ZenohAnchorClient` on threads of its own, because zenoh's Python calls block.

        async with AsyncZenohAnchorClient("tcp/127.0.0.1:7447") as client:
            anchors = await client.plan(**scene, budget_ms=80)

    Cancelling the task that awaits an answer cancels its request. Zenoh does not notify the
    replica, which drops the request when its budget is over. Errors are those of
    `ZenohAnchorClient`.
    """

    def __init__(
        self,
        where: str | Sequence[str] | ZenohSettings,
        *,
        timeout_s: float = 30.0,
        max_threads: int = 64,
    ) -> None:
        """Check the arguments; the first call connects.

        Args:
            max_threads: concurrent requests; further ones wait for a free thread, and their
                budgets begin after that wait.

        Other arguments, and errors: see `ZenohAnchorClient`.
        """
        self._client = ZenohAnchorClient(where, timeout_s=timeout_s)
        self._threads: ThreadPoolExecutor | None = ThreadPoolExecutor(
            max_threads, thread_name_prefix="anchorflow-zenoh"
        )

    async def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        return await self._in_thread(partial(self._client.plan_request, request))

    async def models(self) -> tuple[ModelCard, ...]:
        return await self._in_thread(self._client.models)

    async def live(self) -> bool:
        return await self._in_thread(self._client.live)

    async def ready(self) -> bool:
        return await self._in_thread(self._client.ready)

    async def aclose(self) -> None:
        await asyncio.to_thread(self._client.close)  # our own threads may all be busy
        threads, self._threads = self._threads, None
        if threads is not None:
            threads.shutdown(wait=False)

    async def _in_thread(self, call: Callable[..., Result]) -> Result:
        loop, cancellation = asyncio.get_running_loop(), Cancellation()
        try:
            # After `aclose` the loop's own threads: the closed client raises at once.
            return await loop.run_in_executor(
                self._threads, partial(call, cancellation=cancellation)
            )
        except asyncio.CancelledError:
            cancellation.cancel()
            raise
