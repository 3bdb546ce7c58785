"""Clients that retry another client's transient errors.

with RetryingClient(AnchorClient("http://127.0.0.1:8000"), patience_s=5.0) as client:
    anchors = client.plan(cost_map=occupancy, resolution=0.1, x_curr=state, x_goal=goal)
"""

from __future__ import annotations

import random
import time
from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Generic, TypeVar

from anchorflow_client.base_client import BaseAsyncClient, BaseClient
from anchorflow_client.contract import AnchorBatch, AnchorRequest, ModelCard
from anchorflow_client.retry_policy import RETRIED, Attempts, check_times

Answer = TypeVar("Answer")
Inner = TypeVar("Inner")
Slept = TypeVar("Slept")


class _Retrying(ABC, Generic[Inner, Slept]):
    """The constructor of both clients."""

    def __init__(
        self,
        client: Inner,
        *,
        patience_s: float = 10.0,
        first_pause_s: float = 0.1,
        longest_pause_s: float = 2.0,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], Slept] | None = None,
        draw: Callable[[], float] = random.random,
    ) -> None:
        """Set the policy; nothing is sent yet.

        Args:
            client: the client to call; it is closed with this one.
            patience_s: longest time from the first attempt to the beginning of the last.
            first_pause_s: longest pause after the first attempt.
            longest_pause_s: upper bound of the growing pauses.
            clock: returns the time in s.
            sleep: waits for a number of s; by default `time.sleep` or `asyncio.sleep`.
            draw: returns a number from 0 to 1. A pause lasts from half its length to all of it, so
                that clients that failed together do not retry together.

        Raises:
            UsageError: a time is not above 0.
        """
        self._client = client
        times_s = {
            "patience_s": patience_s,
            "first_pause_s": first_pause_s,
            "longest_pause_s": longest_pause_s,
        }
        check_times(**times_s)
        numbers_s = {name: float(time_s) for name, time_s in times_s.items()}
        self._attempts = partial(Attempts, **numbers_s, clock=clock, draw=draw)
        self._sleep = sleep or self._default_sleep

    @abstractmethod
    def _default_sleep(self, seconds: float, /) -> Slept: ...


class RetryingClient(_Retrying[BaseClient, object], BaseClient):
    """Calls another client, and retries transient errors: planning is idempotent.

    After `Overloaded` it waits for as long as the service said; after `NotReady`,
    `ConnectionFailed` and `TimedOut` for a pause that doubles from one attempt to the next. It
    begins no attempt after `patience_s`, nor after the request's `budget_ms`, and then raises the
    last error. Every other error is raised at once.

    The budget that is sent shrinks by the time that has passed. An attempt that has begun is not
    cut short: without a budget it lasts as long as the inner client waits.

    Several threads may share it if they may share the inner client.
    """

    def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        attempts = self._attempts(request.budget_ms)
        return self._retry(lambda: self._client.plan_request(attempts.remaining(request)), attempts)

    def models(self) -> tuple[ModelCard, ...]:
        return self._retry(self._client.models, self._attempts())

    def live(self) -> bool:
        return self._client.live()

    def ready(self) -> bool:
        return self._client.ready()

    def close(self) -> None:
        self._client.close()

    def _retry(self, call: Callable[[], Answer], attempts: Attempts) -> Answer:
        while True:
            try:
                return call()
            except RETRIED as error:  # noqa: PERF203 - an attempt takes longer than the try
                self._sleep(attempts.pause_after(error))
                attempts.resume(error)

    def _default_sleep(self, seconds: float, /) -> object:
        return time.sleep(seconds)


class AsyncRetryingClient(_Retrying[BaseAsyncClient, Awaitable[object]], BaseAsyncClient):
    """`RetryingClient` over an async client. Cancelling the task ends the retries."""

    async def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        attempts = self._attempts(request.budget_ms)
        return await self._retry(
            lambda: self._client.plan_request(attempts.remaining(request)), attempts
        )

    async def models(self) -> tuple[ModelCard, ...]:
        return await self._retry(self._client.models, self._attempts())

    async def live(self) -> bool:
        return await self._client.live()

    async def ready(self) -> bool:
        return await self._client.ready()

    async def aclose(self) -> None:
        await self._client.aclose()

    async def _retry(self, call: Callable[[], Awaitable[Answer]], attempts: Attempts) -> Answer:
        while True:
            try:
                return await call()
            except RETRIED as error:  # noqa: PERF203 - an attempt takes longer than the try
                await self._sleep(attempts.pause_after(error))
                attempts.resume(error)

    async def _default_sleep(self, seconds: float, /) -> object:
        import asyncio  # here, so that a blocking robot does not load it

        return await asyncio.sleep(seconds)
