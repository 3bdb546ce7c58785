"""Another client, asked again where that may help.

with RetryingClient(AnchorClient("http://127.0.0.1:8000"), patience_s=5.0) as client:
    anchors = client.plan(cost_map=occupancy, resolution=0.1, x_curr=state, x_goal=goal)
"""

from __future__ import annotations

import logging
import random
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TypeVar

from anchorflow_client.base_client import BaseClient
from anchorflow_client.contract import AnchorBatch, AnchorRequest, ModelCard
from anchorflow_client.errors import (
    ConnectionFailed,
    NotReady,
    Overloaded,
    TimedOut,
)

Answer = TypeVar("Answer")

RETRIED = (Overloaded, NotReady, ConnectionFailed, TimedOut)
"""What the same request may not meet a moment later."""

logger = logging.getLogger(__name__)


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
        times = {
            "patience_s": patience_s,
            "first_pause_s": first_pause_s,
            "longest_pause_s": longest_pause_s,
        }
        for name, seconds in times.items():
            if not seconds > 0.0:
                raise ValueError(f"{name}: expected a number above 0, got {seconds}")
        self._client = client
        self._patience_s = patience_s
        self._first_pause_s = first_pause_s
        self._longest_pause_s = longest_pause_s
        self._clock = clock
        self._sleep = sleep
        self._draw = draw

    def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        """Anchors for a request that was built before."""
        budget_ms = request.budget_ms
        if budget_ms is None:
            return self._patiently(lambda _: self._client.plan_request(request), self._patience_s)

        def attempt(passed_s: float) -> AnchorBatch:
            left = replace(request, budget_ms=budget_ms - 1e3 * passed_s)
            return self._client.plan_request(left if passed_s else request)

        return self._patiently(attempt, min(self._patience_s, budget_ms / 1e3))

    def models(self) -> tuple[ModelCard, ...]:
        """The cards of all bundles that are served, the default first."""
        return self._patiently(lambda _: self._client.models(), self._patience_s)

    def live(self) -> bool:
        """Whether a service answers now; False where nobody listens."""
        return self._client.live()

    def ready(self) -> bool:
        """Whether it takes requests now; False while it starts or stops, or nobody listens."""
        return self._client.ready()

    def close(self) -> None:
        """Close the client beneath."""
        self._client.close()

    def _patiently(self, attempt: Callable[[float], Answer], patience_s: float) -> Answer:
        """What an attempt gives, which is told how many s have passed before it."""
        start, passed_s, pauses = self._clock(), 0.0, self._pauses()
        while True:
            try:
                return attempt(passed_s)
            except RETRIED as error:  # noqa: PERF203 - an attempt takes longer than the try
                pause_s = max(next(pauses), getattr(error, "retry_after_s", None) or 0.0)
                if self._clock() - start + pause_s >= patience_s:
                    raise
                logger.info("asking again in %.2f s: %s: %s", pause_s, type(error).__name__, error)
                self._sleep(pause_s)
                passed_s = self._clock() - start
                if passed_s >= patience_s:  # it slept too long
                    raise

    def _pauses(self) -> Iterator[float]:
        longest_s = self._first_pause_s
        while True:
            longest_s = min(longest_s, self._longest_pause_s)
            yield longest_s * (0.5 + 0.5 * self._draw())
            longest_s *= 2.0
