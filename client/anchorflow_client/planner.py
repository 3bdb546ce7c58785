"""A planner for control loops: it asks in the background and never makes the loop wait.

    with AnchorClient("http://127.0.0.1:8000", timeout_s=1.0) as client, Planner(client) as planner:
        while driving:
            plan = planner.update(cost_map=grid, resolution=0.08, x_curr=state, x_goal=goal)
            if plan.usable:
                planner.follow(drive_along(plan))
            else:
                brake()

All methods are for the one thread that runs the loop.
"""

from __future__ import annotations

import secrets
import time
from collections import Counter
from collections.abc import Callable, Mapping
from concurrent import futures
from dataclasses import dataclass
from types import TracebackType
from typing import Any, NamedTuple, Protocol

from numpy.typing import ArrayLike

from anchorflow_client.contract import AnchorBatch, AnchorRequest, CostMap
from anchorflow_client.errors import (
    AnchorFlowError,
    InvalidAnswer,
    InvalidRequest,
    Overloaded,
    TimedOut,
)
from anchorflow_client.planner_plan import Plan, PlanState
from anchorflow_client.planner_request import (
    AnchorInUse,
    Observation,
    RequestConfig,
    build_request,
)

MAX_IN_FLIGHT = 2  # a request that hangs may be given up once before there is an answer again


class AnchorSource(Protocol):
    """Whatever answers requests: `AnchorClient`, or another client of the same interface."""

    def plan_request(self, request: AnchorRequest) -> AnchorBatch:
        """Blocks until there is an answer. Raises `AnchorFlowError` where there is none."""
        ...


@dataclass(frozen=True, kw_only=True)
class PlannerConfig(RequestConfig):
    """How often is asked, and how old a plan may grow."""

    max_age_ms: float = 1000.0
    """From when a plan is expired and a request is given up; also each request's budget_ms."""
    period_ms: float = 100.0
    """Least time between two requests."""
    first_retry_ms: float = 100.0
    """Wait after a failure; it doubles from one failure to the next."""
    longest_retry_ms: float = 500.0

    def __post_init__(self) -> None:
        """Raises `ValueError` where a setting is out of range."""
        super().__post_init__()
        for name in ("max_age_ms", "period_ms", "first_retry_ms", "longest_retry_ms"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name}: expected a number above 0, got {getattr(self, name)}")


class Asking(NamedTuple):
    """A request on its way."""

    request_id: str
    seen_at: float
    future: futures.Future[AnchorBatch]


class Answer(NamedTuple):
    """The newest good answer."""

    request_id: str
    seen_at: float
    batch: AnchorBatch


class Planner:
    """Asks a client for anchors in the background and hands out the newest finished batch.

    `counts` says how many requests were asked, answered, failed, and dropped because their answer
    came too late.
    """

    def __init__(
        self,
        client: AnchorSource,
        config: PlannerConfig = PlannerConfig(),
        *,
        clock: Callable[[], float] = time.monotonic,
        executor: futures.Executor | None = None,
    ) -> None:
        """Asks nothing yet.

        Args:
            client: answers; it should itself give up after about `config.max_age_ms`.
            config: ages and periods.
            clock: the time in s.
            executor: where requests wait for their answer; a pool of two threads unless told.
        """
        self.counts: Counter[str] = Counter()
        self._client = client
        self._config = config
        self._clock = clock
        self._own_executor = executor is None
        self._executor = executor or futures.ThreadPoolExecutor(
            MAX_IN_FLIGHT, thread_name_prefix="anchorflow-planner"
        )
        self._run = secrets.token_hex(4)
        self._asking: Asking | None = None
        self._given_up: list[Asking] = []
        self._answer: Answer | None = None
        self._in_use: AnchorInUse | None = None
        self._last_error: AnchorFlowError | None = None
        self._failures = 0
        self._not_before = -float("inf")

    def update(
        self,
        *,
        cost_map: CostMap | Mapping[str, Any] | ArrayLike,
        x_curr: ArrayLike,
        x_goal: ArrayLike,
        **optional: Any,
    ) -> Plan:
        """Show what the loop sees now and take the newest plan; returns at once.

        What is seen becomes a request where none is on its way and it is time for one; otherwise it
        is forgotten.

        Args:
            cost_map: as in `AnchorClient.plan`; it may end before the goal.
            x_curr: [3D] position, velocity, acceleration in m, m/s, m/s^2.
            x_goal: [2D] position, velocity; may lie beyond the map.
            **optional: resolution and origin of a map given as an array, and further fields of
                `AnchorRequest`.

        Raises:
            InvalidRequest: an argument is no single vector. What else is wrong with a request is
                the plan's `last_error`.
        """
        now = self._clock()
        self._collect(now)
        if self._is_due(now):
            self._ask(
                Observation.copied(now, cost_map=cost_map, x_curr=x_curr, x_goal=x_goal, **optional)
            )
        return self._plan(now)

    def follow(self, index: int) -> None:
        """Say which anchor of the plan handed out last is driven along.

        The next request starts from it. Where this is never said, from the batch's best.
        """
        if self._answer is not None:
            self._in_use = AnchorInUse(self._answer.batch, index, self._answer.seen_at)

    def wait(self, timeout_s: float) -> Plan:
        """Wait for the request on its way, at most so long: before the robot starts to move."""
        if self._asking is not None:
            futures.wait([self._asking.future], timeout=timeout_s)
        now = self._clock()
        self._collect(now)
        return self._plan(now)

    def reset(self) -> None:
        """Forget the plan and the request on its way: another goal, or another place."""
        self._give_up()
        self._answer = self._in_use = self._last_error = None

    def close(self) -> None:
        """Ask no more. The client stays open; a request on its way ends by itself."""
        if self._own_executor:
            self._executor.shutdown(wait=False, cancel_futures=True)

    def __enter__(self) -> Planner:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def _is_due(self, now: float) -> bool:
        return (
            self._asking is None and now >= self._not_before and len(self._given_up) < MAX_IN_FLIGHT
        )

    def _ask(self, seen: Observation) -> None:
        request_id = f"{self._run}-{self.counts['asked']}"
        cold = self.counts["asked"] % self._config.cold_every == 0
        in_use = None if cold else self._in_use or self._best()
        self.counts["asked"] += 1
        self._not_before = seen.seen_at + 1e-3 * self._config.period_ms
        future = self._executor.submit(self._answered, seen, request_id, in_use)
        self._asking = Asking(request_id, seen.seen_at, future)

    def _answered(
        self, seen: Observation, request_id: str, in_use: AnchorInUse | None
    ) -> AnchorBatch:
        """Runs in the background: the answer to what was seen. Raises `AnchorFlowError`."""
        request = build_request(
            seen,
            self._config,
            request_id=request_id,
            budget_ms=self._config.max_age_ms,
            in_use=in_use,
        )
        return self._client.plan_request(request)

    def _best(self) -> AnchorInUse | None:
        if self._answer is None:
            return None
        return AnchorInUse(self._answer.batch, int(self._answer.batch.best), self._answer.seen_at)

    def _collect(self, now: float) -> None:
        """Take the answer that has come, or give up the request that has taken too long."""
        finished = [asking for asking in self._given_up if asking.future.done()]
        self.counts["dropped"] += len(finished)
        self._given_up = [asking for asking in self._given_up if asking not in finished]
        if self._asking is None:
            return
        if self._too_old(self._asking.seen_at, now):
            late = f"no answer to {self._asking.request_id} within {self._config.max_age_ms:g} ms"
            self._give_up()
            self._failed(TimedOut(late), now)
        elif self._asking.future.done():
            asking, self._asking = self._asking, None
            self._finish(asking, now)

    def _finish(self, asking: Asking, now: float) -> None:
        try:
            batch = asking.future.result()
        except AnchorFlowError as error:
            self._failed(error, now)
            return
        if batch.request_id != asking.request_id:
            wrong = f"expected the answer to {asking.request_id}, got that to {batch.request_id}"
            self._failed(InvalidAnswer(wrong), now)
            return
        self.counts["answered"] += 1
        self._answer = Answer(asking.request_id, asking.seen_at, batch)
        self._last_error, self._failures = None, 0

    def _failed(self, error: AnchorFlowError, now: float) -> None:
        self.counts["failed"] += 1
        self._last_error = error
        if isinstance(error, InvalidRequest):
            return  # the service is well, and the next view of the world may be too
        wait_ms = min(
            self._config.first_retry_ms * 2.0**self._failures, self._config.longest_retry_ms
        )
        if isinstance(error, Overloaded) and error.retry_after_s is not None:
            wait_ms = max(wait_ms, 1e3 * error.retry_after_s)
        self._failures += 1
        self._not_before = max(self._not_before, now + 1e-3 * wait_ms)

    def _give_up(self) -> None:
        if self._asking is not None:
            self._given_up.append(self._asking)
            self._asking = None

    def _too_old(self, seen_at: float, now: float) -> bool:
        return 1e3 * (now - seen_at) > self._config.max_age_ms

    def _plan(self, now: float) -> Plan:
        if self._answer is None:
            return Plan(PlanState.WAITING, last_error=self._last_error)
        expired = self._too_old(self._answer.seen_at, now)
        alive = PlanState.FRESH if self._last_error is None else PlanState.HELD
        return Plan(
            PlanState.EXPIRED if expired else alive,
            batch=None if expired else self._answer.batch,
            age_ms=1e3 * (now - self._answer.seen_at),
            request_id=self._answer.request_id,
            last_error=self._last_error,
        )
