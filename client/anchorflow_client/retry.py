"""Another client, asked again where that may help.

with RetryingClient(AnchorClient("http://127.0.0.1:8000"), patience_s=5.0) as client:
    anchors = client.plan(cost_map=occupancy, resolution=0.1, x_curr=state, x_goal=goal)
"""

from __future__ import annotations

import random
import time
from collections.abc import Awaitable, Callable
from typing import TypeVar

from anchorflow_client.base_client import BaseAsyncClient, BaseClient
from anchorflow_client.contract import AnchorBatch, AnchorRequest, ModelCard
from anchorflow_client.patience import RETRIED, Attempts, Patience

Answer = TypeVar("Answer")


class RetryingClient(BaseClient):
    """Asks another client, and asks again after errors that pass: planning is idempotent.

    After `Overloaded` it waits for as long as the service said, after `NotReady`,
    `ConnectionFailed` and `TimedOut` for a pause that doubles from one attempt to the next. It
    begins no attempt after `patience_s`, nor after the request's `budget_ms`, and then raises the
    last error; every other error it raises at once.

    The budget that is sent shrinks by what has passed. An attempt that has begun is not cut short:
    without a budget it lasts as long as the client beneath waits for it.

    Several threads may share it where they may share the client beneath.
    """

    def __init__(
        self,
        client: BaseClient,
        *,
        patience_s: float = 10.0,
        first_pause_s: float = 0.1,
        longest_pause_s: float = 2.0,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], object] = time.sleep,
        draw: Callable[[], float] = random.random,
    ) -> None:
        """Asks nothing yet.

        Args:
            client: answers; it is closed with this one.
            patience_s: from the first attempt to the beginning of the last, at most.
            first_pause_s: longest pause after the first attempt.
            longest_pause_s: where the pauses stop to grow.
            clock: the time in s.
            sleep: waits for so many s.
            draw: from 0 to 1; a pause is from half its length to all of it, so that clients that
                failed together do not come back together.

        Raises:
            ValueError: a time is not above 0.
        """
        self._client = client
        self._patience = Patience(
            patience_s=patience_s,
            first_pause_s=first_pause_s,
            longest_pause_s=longest_pause_s,
            clock=clock,
            draw=draw,
        )
        self._sleep = sleep

    def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        """Anchors for a request that was built before."""
        attempts = self._patience.attempts(request.budget_ms)
        return self._patiently(
            lambda: self._client.plan_request(attempts.what_is_left_of(request)), attempts
        )

    def models(self) -> tuple[ModelCard, ...]:
        """The cards of all bundles that are served, the default first."""
        return self._patiently(self._client.models, self._patience.attempts())

    def live(self) -> bool:
        """Whether a service answers now; False where nobody listens."""
        return self._client.live()

    def ready(self) -> bool:
        """Whether it takes requests now; False while it starts or stops, or nobody listens."""
        return self._client.ready()

    def close(self) -> None:
        """Close the client beneath."""
        self._client.close()

    def _patiently(self, attempt: Callable[[], Answer], attempts: Attempts) -> Answer:
        while True:
            try:
                return attempt()
            except RETRIED as error:  # noqa: PERF203 - an attempt takes longer than the try
                self._sleep(attempts.pause_s_after(error))
                attempts.go_on(error)


class AsyncRetryingClient(BaseAsyncClient):
    """`RetryingClient` over an async client. A task that is cancelled asks no more."""

    def __init__(
        self,
        client: BaseAsyncClient,
        *,
        patience_s: float = 10.0,
        first_pause_s: float = 0.1,
        longest_pause_s: float = 2.0,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], Awaitable[object]] | None = None,
        draw: Callable[[], float] = random.random,
    ) -> None:
        """Asks nothing yet; the arguments are those of `RetryingClient`.

        Raises:
            ValueError: a time is not above 0.
        """
        self._client = client
        self._patience = Patience(
            patience_s=patience_s,
            first_pause_s=first_pause_s,
            longest_pause_s=longest_pause_s,
            clock=clock,
            draw=draw,
        )
        self._sleep = sleep or _sleep

    async def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        """Anchors for a request that was built before."""
        attempts = self._patience.attempts(request.budget_ms)
        return await self._patiently(
            lambda: self._client.plan_request(attempts.what_is_left_of(request)), attempts
        )

    async def models(self) -> tuple[ModelCard, ...]:
        """The cards of all bundles that are served, the default first."""
        return await self._patiently(self._client.models, self._patience.attempts())

    async def live(self) -> bool:
        """Whether a service answers now; False where nobody listens."""
        return await self._client.live()

    async def ready(self) -> bool:
        """Whether it takes requests now; False while it starts or stops, or nobody listens."""
        return await self._client.ready()

    async def aclose(self) -> None:
        """Close the client beneath."""
        await self._client.aclose()

    async def _patiently(
        self, attempt: Callable[[], Awaitable[Answer]], attempts: Attempts
    ) -> Answer:
        while True:
            try:
                return await attempt()
            except RETRIED as error:  # noqa: PERF203 - an attempt takes longer than the try
                await self._sleep(attempts.pause_s_after(error))
                attempts.go_on(error)


async def _sleep(seconds: float) -> None:
    import asyncio  # here, so that a blocking robot does not load it

    await asyncio.sleep(seconds)
