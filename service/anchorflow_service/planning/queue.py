"""The queue in front of the engines: admission, micro-batches, and the lanes that run them.

A lane is a thread that runs one job at a time; nothing blocks the event loop. A free lane takes the
oldest waiting job and, as a micro-batch, those of the same key. The lanes share a batch, one job
each; if other lanes are idle, a job gets their threads too.
"""

from __future__ import annotations

import asyncio
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, TypeVar

from anchorflow_client.errors import NotReady, Overloaded
from anchorflow_service.planning.job import AnyJob, Arrival, Job, JobCancelled, JobContext
from anchorflow_trajectory.threads import usable_cores

Result = TypeVar("Result")

SMOOTHING = 0.2
"""Weight of the latest request in the running mean of the service time."""


@dataclass(frozen=True)
class ServiceLimits:
    """Bounds on memory, on waiting and on concurrent work."""

    max_body_bytes: int = 16 * 2**20
    """A longer body is `too_large`."""
    max_waiting: int = 64
    """Requests that may wait; one more is `overloaded`."""
    max_batch: int = 16
    """Requests in a micro-batch; 1: one at a time, each on all threads."""
    batch_wait_ms: float = 0.0
    """Time that the first request of a micro-batch waits for others to join."""
    threads: int | None = None
    """Shared by the requests that are planned at a time; None: this process's cores."""

    def __post_init__(self) -> None:
        """Raises `ValueError` for a bound that is too low."""
        for name, least in (("max_body_bytes", 1), ("max_waiting", 0), ("max_batch", 1)):
            if getattr(self, name) < least:
                raise ValueError(f"{name}: expected at least {least}, got {getattr(self, name)}")
        if not 0.0 <= self.batch_wait_ms < float("inf"):
            raise ValueError(f"batch_wait_ms: expected 0 or more, got {self.batch_wait_ms}")
        if self.threads is not None and self.threads < 1:
            raise ValueError(f"threads: expected at least 1, got {self.threads}")


class _Assignment(NamedTuple):
    job: AnyJob
    threads: int


class PlanningQueue:
    """Runs as many jobs at a time as it has lanes, lets some wait and refuses the rest.

    It takes jobs inside its `with` block only.

    Args:
        limits: bounds on waiting and on batches.
        clock: seconds, for the time in the queue and the service time.
        on_batch: called with the size of every batch, on a lane's thread.
    """

    def __init__(
        self,
        limits: ServiceLimits,
        *,
        clock: Callable[[], float] = time.perf_counter,
        on_batch: Callable[[int], None] = lambda _: None,
    ) -> None:
        self._limits = limits
        self._on_batch = on_batch
        self._clock = clock
        self._num_threads = limits.threads or usable_cores()
        self.num_lanes = min(self._num_threads, limits.max_batch)
        """Jobs that run at a time."""
        self.in_flight = 0
        """Requests that are read, wait or run."""
        self.mean_service_s = 0.0
        """Running mean of a request's time on a lane; 0 before the first."""
        # Guards all attributes below; lanes wait on it for jobs.
        self._changed = threading.Condition()
        self._line: list[AnyJob] = []
        self._batch: deque[_Assignment] = deque()
        self._awaited: set[AnyJob] = set()
        self._busy_lanes = 0
        self._lanes: list[threading.Thread] = []
        self._has_lanes = False
        self.is_open = False
        """Whether the queue takes jobs."""

    @contextmanager
    def place(self, *, beyond: int = 0) -> Iterator[None]:
        """Hold a place among the requests that wait or run, for the length of the block.

        beyond: additional places, for requests that `submit` may still refuse

        Raises `NotReady`, or `Overloaded` with an estimate of when a place is free.
        """
        if not self.is_open:
            raise NotReady("the service is starting or stopping")
        with self._changed:
            self._check_room(self.in_flight, self._limits.max_waiting + beyond)
            self.in_flight += 1
        try:
            yield
        finally:
            with self._changed:
                self.in_flight -= 1

    @property
    def num_waiting(self) -> int:
        """Return the number of jobs that no lane has taken."""
        with self._changed:
            return self._count_waiting()

    @property
    def oldest_wait_s(self) -> float:
        """Return the age of the oldest job that no lane has taken; 0 if there is none."""
        with self._changed:
            # Jobs of a batch are older than those in the line.
            first = next(self._left_in_batch(), next(iter(self._line), None))
            return 0.0 if first is None else self._clock() - first.submitted

    async def run(
        self,
        work: Callable[[JobContext], Result],
        *,
        arrival: Arrival | None = None,
        budget_ms: float | None = None,
    ) -> Result:
        """Run a function on a lane of its own, as `submit` does with a job, which arrives now."""
        arrival = arrival or Arrival(clock=self._clock)
        return await self.submit(Job(work, arrival, budget_ms=budget_ms))

    async def submit(self, job: Job[Result]) -> Result:
        """Run a job and return its result; cancelling this cancels the job.

        Raises `NotReady`, `Overloaded` if too many wait for its budget, or `DeadlineExceeded`.
        """
        with self.admitted(job):
            return await self.result_of(job)

    @contextmanager
    def admitted(self, job: Job[Result], *, in_place_of: AnyJob | None = None) -> Iterator[None]:
        """Keep the job in the line or on a lane, for the length of the block. Raises as `submit`.

        in_place_of: a job that is cancelled inside the block; it does not count as ahead
        """
        with self._changed:
            if not self.is_open:
                raise NotReady("the service is stopping")
            leaves = in_place_of is not None and not in_place_of.has_ended
            waiting = self._count_waiting()
            self._check_room(waiting + self._busy_lanes - leaves)
            ahead = waiting if in_place_of is None else self._count_waiting(but=in_place_of)
            self._check_worth_waiting(job, ahead=ahead)
            job.submitted = self._clock()
            self._line.append(job)
            self._awaited.add(job)
            self._changed.notify()
        try:
            yield
        finally:
            job.cancel(JobCancelled())
            with self._changed:
                if job in self._line:
                    self._line.remove(job)
                self._awaited.discard(job)

    async def result_of(self, job: Job[Result]) -> Result:
        """Return the result of an admitted job. Raises `DeadlineExceeded` past its budget."""
        if job.budget_ms is None:
            return await asyncio.wrap_future(job.result)
        left_s = job.arrival.left_ms(job.budget_ms) / 1e3
        alarm = asyncio.get_running_loop().call_later(left_s, job.expire)
        try:
            return await asyncio.wrap_future(job.result)
        finally:
            alarm.cancel()

    def cancel_all(self) -> None:
        """End all jobs that wait or run, and refuse new ones, as `not_ready`."""
        with self._changed:
            self.is_open = False
            awaited = list(self._awaited)
        for job in awaited:
            job.cancel(NotReady("the service is stopping"))

    def __enter__(self) -> PlanningQueue:
        self._has_lanes = self.is_open = True
        self._lanes = [
            threading.Thread(target=self._work_on, name=f"planning-{lane}", daemon=True)
            for lane in range(self.num_lanes)
        ]
        for lane in self._lanes:
            lane.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Refuse waiting jobs, and wait for those that run."""
        with self._changed:
            self._has_lanes = self.is_open = False
            left = [*self._line, *(assignment.job for assignment in self._batch)]
            self._line.clear()
            self._batch.clear()
            self._changed.notify_all()
        for job in left:
            job.cancel(NotReady("the service is stopping"))
        for lane in self._lanes:
            lane.join()

    def _work_on(self) -> None:
        """Run jobs on this lane until the queue closes."""
        while (assignment := self._next()) is not None:
            job, threads = assignment
            began = self._clock()
            wait_ms = (began - job.submitted) * 1e3
            job.run(queue_ms=wait_ms, threads=threads, freed=partial(self._free, began))

    def _free(self, began: float, was_done: bool) -> None:
        """Mark a lane as free that was taken at that time [s]."""
        with self._changed:
            self._busy_lanes -= 1
            if was_done:
                service_s = self._clock() - began
                mean_s = self.mean_service_s or service_s
                self.mean_service_s = mean_s + SMOOTHING * (service_s - mean_s)

    def _next(self) -> _Assignment | None:
        """Wait for the next job of a lane; return None once the queue is closed."""
        with self._changed:
            while not self._batch:
                if not self._has_lanes:
                    return None
                wait_s = self._form_batch()
                if not self._batch:
                    self._changed.wait(wait_s)
            self._busy_lanes += 1
            return self._batch.popleft()

    def _form_batch(self) -> float | None:
        """Form a batch from the head of the line, or return how long [s] others may still join."""
        self._line = [job for job in self._line if _is_wanted(job)]
        if not self._line:
            return None
        first, *others = self._line
        alike = [other for other in others if first.key is not None and other.key == first.key]
        jobs = [first, *alike[: self._limits.max_batch - 1]]
        wait_s = self._limits.batch_wait_ms / 1e3 - (self._clock() - first.submitted)
        if len(jobs) < self._limits.max_batch and wait_s > 0:
            return wait_s
        self._line = [job for job in self._line if job not in jobs]
        self._on_batch(len(jobs))
        idle_lanes = self.num_lanes - self._busy_lanes
        threads = idle_lanes * self._num_threads // (self.num_lanes * len(jobs))
        self._batch.extend(_Assignment(job, max(1, threads)) for job in jobs)
        # Wake a lane for each other job, and one for the line.
        self._changed.notify(len(jobs) - 1 + bool(self._line))
        return None

    def _count_waiting(self, *, but: AnyJob | None = None) -> int:
        line = (job for job in self._line if not job.has_ended)
        return sum(job is not but for job in (*line, *self._left_in_batch()))

    def _left_in_batch(self) -> Iterator[AnyJob]:
        """Yield the jobs of the batch that no lane has taken."""
        return (each.job for each in self._batch if not each.job.has_ended)

    def _check_room(self, held: int, max_waiting: int | None = None) -> None:
        """Raise `Overloaded` if no place is free."""
        waiting = held - self.num_lanes
        if waiting >= (self._limits.max_waiting if max_waiting is None else max_waiting):
            raise self._overloaded(f"{waiting} requests wait already", held)

    def _check_worth_waiting(self, job: AnyJob, *, ahead: int) -> None:
        """Raise `Overloaded` if the jobs ahead and the job itself likely outlast its budget.

        A job with none ahead is never refused: the estimate learns from it.
        """
        if job.budget_ms is None or not ahead:
            return
        likely_ms = self._wait_s(ahead + self.num_lanes) * 1e3
        if likely_ms > job.arrival.left_ms(job.budget_ms):
            wait = f"{ahead} requests wait already, an answer would take about {likely_ms:.0f} ms"
            raise self._overloaded(f"{wait} of a budget of {job.budget_ms:g} ms", ahead)

    def _overloaded(self, message: str, ahead: int) -> Overloaded:
        wait_s = max(1, math.ceil(self._wait_s(ahead)))  # Retry-After has whole seconds
        return Overloaded(f"{message}; try again in {wait_s} s", retry_after_s=wait_s)

    def _wait_s(self, ahead: int) -> float:
        """Estimate the time until a lane is free, behind some running or waiting requests."""
        return self.mean_service_s * ahead / self.num_lanes


def _is_wanted(job: AnyJob) -> bool:
    """Return whether a waiting job has not ended; end it if its budget is spent."""
    if job.budget_ms is not None and not job.arrival.left_ms(job.budget_ms):
        job.expire()
    return not job.has_ended
