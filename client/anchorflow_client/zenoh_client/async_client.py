"""The async client: asks services for anchors over zenoh from an event loop."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import TypeVar

from anchorflow_client.base_client import BaseAsyncClient
from anchorflow_client.cancellation import Cancellation
from anchorflow_client.contract import AnchorBatch, AnchorRequest, ModelCard
from anchorflow_client.zenoh_client.client import ZenohAnchorClient
from anchorflow_client.zenoh_client.settings import ZenohSettings

Result = TypeVar("Result")


class AsyncZenohAnchorClient(BaseAsyncClient):
    """`ZenohAnchorClient` on threads of its own: zenoh's Python calls block.

        async with AsyncZenohAnchorClient("tcp/127.0.0.1:7447") as client:
            anchors = await client.plan(**scene, budget_ms=80)

    Where the task that awaits an answer is cancelled, its request is taken back. Zenoh does not
    tell the replica: it drops the request when the budget is over. Errors are those of
    `ZenohAnchorClient`.
    """

    def __init__(
        self,
        where: str | Sequence[str] | ZenohSettings,
        *,
        timeout_s: float = 30.0,
        max_threads: int = 64,
    ) -> None:
        """Opens nothing yet.

        Args:
            where: endpoints to connect to, such as tcp/127.0.0.1:7447, or settings.
            timeout_s: longest wait for an answer, and the budget that the service is told, where
                the request brings none.
            max_threads: requests on their way at the same time; others wait for a place, and their
                budgets begin when they have one.

        Raises:
            ValueError: `timeout_s` is not above 0 or is over 10⁶ s, or there is no thread.
        """
        self._client = ZenohAnchorClient(where, timeout_s=timeout_s)
        self._threads: ThreadPoolExecutor | None = ThreadPoolExecutor(
            max_threads, thread_name_prefix="anchorflow-zenoh"
        )

    async def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        """Anchors for a request that was built before."""
        return await self._on_a_thread(partial(self._client.plan_request, request))

    async def models(self) -> tuple[ModelCard, ...]:
        """The cards of all bundles that are served, the default first."""
        return await self._on_a_thread(self._client.models)

    async def live(self) -> bool:
        """Whether a service is there; False where there is none, or no way to it."""
        return await self._on_a_thread(self._client.live)

    async def ready(self) -> bool:
        """Whether a replica takes requests now; False while all start or stop, or none is there."""
        return await self._on_a_thread(self._client.ready)

    async def aclose(self) -> None:
        """Leave the network; requests that wait for an answer are taken back."""
        await asyncio.to_thread(self._client.close)  # there is always a place on the loop's own
        threads, self._threads = self._threads, None
        if threads is not None:
            threads.shutdown(wait=False)

    async def _on_a_thread(self, call: Callable[..., Result]) -> Result:
        loop, cancellation = asyncio.get_running_loop(), Cancellation()
        try:
            # Without threads, the loop's own: a client that is closed says so at once.
            return await loop.run_in_executor(
                self._threads, partial(call, cancellation=cancellation)
            )
        except asyncio.CancelledError:
            cancellation.cancel()
            raise
