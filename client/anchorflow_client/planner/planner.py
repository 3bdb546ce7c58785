"""A planner for control loops: it sends requests in the background and never blocks the loop.

    with AnchorClient("http://127.0.0.1:8000", timeout_s=1.0) as client, Planner(client) as planner:
        while driving:
            plan = planner.update(cost_map=grid, resolution=0.08, x_curr=state, x_goal=goal)
            drive_along(plan.states()[plan.best]) if plan.followable else brake()

All methods are for the one thread that runs the loop.
"""

from __future__ import annotations

import math
import secrets
import time
from collections import Counter
from collections.abc import Callable, Mapping
from concurrent import futures
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from anchorflow_client.base_client import map_fields, spelled_out
from anchorflow_client.codec import answer_to
from anchorflow_client.contract import AnchorBatch, CostMap
from anchorflow_client.contract.batch import MOTIONS
from anchorflow_client.contract.checks import Interval, integer
from anchorflow_client.contract.fields import SEED, PlanOptions
from anchorflow_client.errors import (
    AnchorFlowError,
    ConnectionFailed,
    InvalidAnswer,
    InvalidRequest,
    TimedOut,
)
from anchorflow_client.planner.config import Pacing, PlannerConfig
from anchorflow_client.planner.plan import Plan, PlanState, why_unsafe
from anchorflow_client.planner.request import (
    AnchorInUse,
    AnchorSource,
    Array,
    LimitsSource,
    Observation,
    at_the_state,
    build_request,
    read_own_states,
)
from anchorflow_client.planner.routes import Commitment, Progress, Routes

if TYPE_CHECKING:
    from anchorflow_client.base_client import Unpack

CAUTIOUS_M = 1.0
"""m from a place where nothing was safe, within which the robot stops at local goals."""
MAX_IN_FLIGHT = 2
"""Pending requests: one may hang, and is given up, before the next is sent."""


class _Answer(NamedTuple):
    """An answer, and what its request says about it."""

    request_id: str
    seen_at: float
    place: Array
    """[2] m, of the robot at that time."""
    batch: AnchorBatch
    routes: Routes
    v_max: float
    """m/s, of the robot; infinite if unknown."""
    reason: str | None
    """Why nothing is safe; None if something is."""


class _InFlight(NamedTuple):
    """A pending request."""

    request_id: str
    seen_at: float
    future: futures.Future[_Answer]


class Planner:
    """Requests anchors in the background and returns the newest finished batch.

    `counts` holds how many requests were asked, answered, failed, and dropped because their answer
    was too late, and how often the robot was stuck.
    """

    def __init__(
        self,
        client: AnchorSource,
        config: PlannerConfig | None = None,
        *,
        clock: Callable[[], float] = time.monotonic,
        executor: futures.Executor | None = None,
    ) -> None:
        """Set up the planner; the first `update` sends a request.

        Args:
            client: answers requests; its own timeout should be about `max_age_ms`.
            config: ages and periods.
            clock: returns the time in s; if it goes back, the planner resets itself.
            executor: runs the requests; by default a pool of two threads.
        """
        self.counts: Counter[str] = Counter()
        self._client = client
        self._config = config or PlannerConfig()
        self._clock = clock
        self._last_now = -float("inf")
        self._is_closed = False
        self._limits = LimitsSource(client)
        self._own_executor = executor is None
        self._executor = executor or futures.ThreadPoolExecutor(
            MAX_IN_FLIGHT, thread_name_prefix="anchorflow-planner"
        )
        self._run = secrets.token_hex(4)
        self._in_flight: _InFlight | None = None
        self._given_up: list[_InFlight] = []
        self._answer: _Answer | None = None
        self._best = 0
        self._unsafe_at: Array | None = None
        self._commitment = Commitment(self._config)
        self._progress = Progress(stuck_s=self._config.stuck_s, stuck_m=self._config.stuck_m)
        self._last_error: AnchorFlowError | None = None
        self._pacing = Pacing(self._config)

    @spelled_out(PlanOptions)
    def update(
        self,
        *,
        cost_map: CostMap | Mapping[str, Any] | ArrayLike,
        x_curr: ArrayLike,
        x_goal: ArrayLike,
        resolution: float | None = None,
        origin: ArrayLike | None = None,
        channel_weights: ArrayLike | None = None,
        obstacles_age_s: float = 0.0,
        **options: Unpack[PlanOptions],
    ) -> Plan:
        """Pass the loop's current observation and return the newest plan, without waiting.

        The observation becomes a request if none is pending and one is due; otherwise it is
        dropped. `warm_start` replaces the anchor in use as the start, and `budget_ms` replaces
        `max_age_ms` as the request's budget.

        Args:
            cost_map: as in `AnchorClient.plan`; it may end before the goal.
            x_curr: [3D] position, velocity, acceleration in m, m/s, m/s^2.
            x_goal: [2D] position, velocity; may lie beyond the map.
            resolution, origin, channel_weights: as in `AnchorClient.plan`.
            obstacles_age_s: time since `obstacles` were observed, or until the robot is in the
                state `x_curr`; they are moved on by it, as anchors begin at that state.
            **options:

        Errors in the observation or of a request are not raised: they are the plan's `last_error`.
        """
        now = self._now()
        self._collect(now)
        if self._is_closed:
            self._last_error = ConnectionFailed("the planner is closed, and asks no more")
        stuck = False
        try:
            start, goal = read_own_states(x_curr, x_goal)
            stuck = self._is_stuck(now, start[:2], goal[:2])
            if self._is_due(now):
                if (seed := options.get("seed")) is not None:
                    options["seed"] = self._seed(seed)
                if (obstacles := options.get("obstacles")) is not None:
                    options["obstacles"] = at_the_state(obstacles, obstacles_age_s)
                view = map_fields(cost_map, resolution, origin, channel_weights)
                seen = Observation.copied(now, view, x_curr=start, x_goal=goal, options=options)
                self._ask(seen)
        except InvalidRequest as error:
            self._last_error = error  # the next observation may be valid
        return self._plan(now, stuck=stuck)

    def follow(self, index: int) -> None:
        """Set the anchor of the last plan that the robot follows, if it is not `best`.

        Its route becomes the one in use, and the next request starts from it. Raises
        `InvalidRequest` if there is no anchor of that index.
        """
        if self._answer is not None:
            index = integer(index, "index", Interval(0, len(self._answer.batch.trajectories) - 1))
            self._commitment.in_use = AnchorInUse(self._answer.batch, index, self._answer.seen_at)

    def wait(self, timeout_s: float) -> Plan:
        """Wait for the pending request, as before the robot starts to move, and return the plan."""
        if self._in_flight is not None:
            futures.wait([self._in_flight.future], timeout=timeout_s)
        now = self._now()
        self._collect(now)
        return self._plan(now)

    def reset(self) -> None:
        """Forget the plan and the pending request: for another goal, or after a move by hand."""
        self._give_up()
        self._answer = self._last_error = self._unsafe_at = None
        self._commitment.reset()
        self._progress.reset()
        self._pacing = Pacing(self._config)

    def close(self) -> None:
        """Send no more requests; later plans have a `ConnectionFailed` as their `last_error`.

        The client stays open; a pending request ends by itself.
        """
        self._is_closed = True
        if self._own_executor:
            self._executor.shutdown(wait=False, cancel_futures=True)

    def __enter__(self) -> Planner:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _now(self) -> float:
        """Return the time; reset if it went back."""
        now = self._clock()
        if now < self._last_now:
            self.reset()
        self._last_now = now
        return now

    def _is_due(self, now: float) -> bool:
        if self._is_closed or self._in_flight is not None:
            return False
        return len(self._given_up) < MAX_IN_FLIGHT and self._pacing.is_due(now)

    def _ask(self, seen: Observation) -> None:
        request_id = f"{self._run}-{self.counts['asked']}"
        cold = self.counts["asked"] % self._config.cold_every == 0
        in_use = None if cold else self._commitment.in_use
        self.counts["asked"] += 1
        self._pacing.sent(seen.seen_at)
        stop = (
            self._unsafe_at is not None
            and float(np.linalg.norm(seen.x_curr[:2] - self._unsafe_at)) < CAUTIOUS_M
        )
        future = self._executor.submit(self._answered, seen, request_id, in_use, stop)
        self._in_flight = _InFlight(request_id, seen.seen_at, future)

    def _answered(
        self, seen: Observation, request_id: str, in_use: AnchorInUse | None, stop: bool
    ) -> _Answer:
        """Return the answer to an observation, in the background. Raises `AnchorFlowError`."""
        limits = self._limits.of(seen.options)
        request = build_request(
            seen,
            self._config,
            request_id=request_id,
            budget_ms=self._config.max_age_ms,
            limits=limits,
            in_use=in_use,
            stop=stop,
        )
        batch = answer_to(request, self._client.plan_request(request))
        shape = batch.trajectories.shape
        if any(name not in batch.arrays for name in MOTIONS) or len(shape) != 3:
            wanted, came = ", ".join(MOTIONS), ", ".join(batch.arrays)
            raise InvalidAnswer(f"expected {wanted} [N,T,D], got {came} of {list(shape)}")
        cost_map = CostMap.from_fields(seen.cost_map)
        place, reason = seen.x_curr[:2], why_unsafe(batch)
        routes = Routes.among(batch, cost_map, request.obstacles)
        return _Answer(request_id, seen.seen_at, place, batch, routes, limits.v_max, reason)

    def _seed(self, seed: int) -> int:
        """Return the seed, advanced by one for each time that the robot was stuck."""
        return integer(seed, "seed", SEED) + self.counts["stuck"]

    def _is_stuck(self, now: float, place: Array, goal: Array) -> bool:
        """Return whether the robot is stuck, and give its route up then."""
        driving = self._answer is not None and not self._expired(self._answer, now)
        v_max = math.inf if self._answer is None else self._answer.v_max
        if not self._progress.is_stuck(now, place, goal, driving=driving, v_max=v_max):
            return False
        self.counts["stuck"] += 1
        self._progress.restart(now)
        self._commitment.give_up()
        if (answer := self._answer) is not None:
            self._best = self._commitment.choose(answer.batch, answer.routes, answer.seen_at)
        return True

    def _collect(self, now: float) -> None:
        """Take the answer that has arrived, or give up the request if it is too old."""
        hanging = [given_up for given_up in self._given_up if not given_up.future.done()]
        self.counts["dropped"] += len(self._given_up) - len(hanging)
        self._given_up = hanging
        if self._in_flight is None:
            return
        if self._too_old(self._in_flight.seen_at, now):
            asked, within = self._in_flight.request_id, f"{self._config.max_age_ms:g} ms"
            self._give_up()
            self._failed(TimedOut(f"no answer to {asked} within {within}"), now)
        elif self._in_flight.future.done():
            finished, self._in_flight = self._in_flight, None
            self._finish(finished, now)

    def _finish(self, finished: _InFlight, now: float) -> None:
        try:
            answer = finished.future.result()
        except AnchorFlowError as error:
            self._failed(error, now)
            return
        self.counts["answered"] += 1
        self._best = self._commitment.choose(answer.batch, answer.routes, answer.seen_at)
        self._answer = answer
        if answer.reason is not None:
            self._unsafe_at = answer.place
        self.follow(self._best)
        self._last_error = None
        self._pacing.answered()

    def _failed(self, error: AnchorFlowError, now: float) -> None:
        self.counts["failed"] += 1
        self._last_error = error
        self._pacing.failed(error, now)

    def _give_up(self) -> None:
        if self._in_flight is not None:
            self._given_up.append(self._in_flight)
            self._in_flight = None

    def _too_old(self, seen_at: float, now: float) -> bool:
        return 1e3 * (now - seen_at) > self._config.max_age_ms

    def _expired(self, answer: _Answer, now: float) -> bool:
        over = now - answer.seen_at >= float(answer.batch.durations.max())
        return over or self._too_old(answer.seen_at, now)

    def _plan(self, now: float, *, stuck: bool = False) -> Plan:
        answer = self._answer
        if answer is None:
            return Plan(PlanState.WAITING, last_error=self._last_error, reason="no answer has come")
        common: dict[str, Any] = {
            "age_ms": 1e3 * (now - answer.seen_at),
            "request_id": answer.request_id,
            "last_error": self._last_error,
            "stuck": stuck,
        }
        if self._expired(answer, now):
            return Plan(PlanState.EXPIRED, **common, reason="the last answer is too old")
        return Plan(
            PlanState.FRESH if self._last_error is None else PlanState.HELD,
            batch=answer.batch,
            best=self._best,
            on_route=answer.routes.of == answer.routes.of[self._best],
            reason=answer.reason,
            **common,
        )
