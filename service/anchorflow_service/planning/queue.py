"""The queue in front of the engines: admission, micro-batches, and the lanes that work on them.

A lane is a thread that works on one job at a time; nothing blocks the event loop. A lane that
becomes free takes the oldest waiting job and with it, as a batch, those of the same key. The lanes
share a batch, one job each; a job that finds other lanes idle has their threads too.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from types import TracebackType
from typing import NamedTuple, TypeVar

from anchorflow_client.errors import NotReady, Overloaded
from anchorflow_service.planning.arrival import Arrival
from anchorflow_service.planning.job import Job, JobCancelled, JobContext
from anchorflow_service.planning.limits import ServiceLimits
from anchorflow_service.planning.service_time import ServiceTimeEstimate
from anchorflow_service.planning.waiting import AnyJob, WaitingLine
from anchorflow_trajectory.cores import usable_cores

Result = TypeVar("Result")


class _Assignment(NamedTuple):
    job: AnyJob
    threads: int


class PlanningQueue:
    """Works on as many jobs at a time as it has lanes, lets so many wait, refuses the rest.

    Open inside its `with` block only.

    Args:
        limits: bounds on waiting and on batches.
        clock: seconds, for the time in the queue and the service time.
        on_batch: told the size of every batch, on a lane's thread.
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
        """Jobs that are worked on at a time."""
        self.in_flight = 0
        """Requests that hold a place: read, wait, or are worked on."""
        self._service_time = ServiceTimeEstimate(self.num_lanes)
        # Guards all that follows; lanes wait on it for jobs.
        self._changed = threading.Condition()
        self._line = WaitingLine()
        self._batch: deque[_Assignment] = deque()
        self._awaited: set[AnyJob] = set()
        self._busy_lanes = 0
        self._lanes: list[threading.Thread] = []
        self._is_open = False
        self._takes_jobs = False

    @property
    def is_open(self) -> bool:
        """Whether it takes jobs."""
        return self._takes_jobs

    @property
    def mean_service_s(self) -> float:
        """Running mean of the time that a request takes a lane; 0 before the first."""
        return self._service_time.mean_s

    @contextmanager
    def place(self, *, beyond: int = 0) -> Iterator[None]:
        """One of the places of those who wait or are worked on, as long as the block lasts.

        beyond: so many more may be inside, to be read and perhaps refused by `submit`

        Raises:
            NotReady: the queue takes no jobs.
            Overloaded: no place is free, with the time until one likely is.
        """
        if not self._takes_jobs:
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
        """Jobs that somebody waits for and no lane has taken."""
        with self._changed:
            return self._count_waiting()

    @property
    def oldest_wait_s(self) -> float:
        """How long the oldest that no lane has taken has waited; 0 where nobody waits."""
        with self._changed:
            # A batch stood before all that is in the line.
            first = next(self._left_in_batch(), self._line.first)
            return 0.0 if first is None else self._clock() - first.submitted

    async def run(
        self,
        work: Callable[[JobContext], Result],
        *,
        arrival: Arrival | None = None,
        budget_ms: float | None = None,
    ) -> Result:
        """What work that is no request returns; it has a lane to itself.

        Args:
            work: the function to run, on a lane's thread.
            arrival: when the caller asked; None: now.
            budget_ms: from then on; None: the caller waits as long as it takes.

        Raises:
            NotReady, Overloaded, DeadlineExceeded: as `submit`.
        """
        arrival = arrival or Arrival(clock=self._clock)
        return await self.submit(Job(work, arrival, budget_ms=budget_ms))

    async def submit(self, job: Job[Result]) -> Result:
        """What the job's work returns; whoever cancels this cancels the job.

        Raises:
            NotReady: the queue is closing.
            Overloaded: too many wait, or likely take longer than the job's budget.
            DeadlineExceeded: the budget ran out.
        """
        with self.admitted(job):
            return await self.result_of(job)

    @contextmanager
    def admitted(self, job: Job[Result], *, in_place_of: AnyJob | None = None) -> Iterator[None]:
        """The job has a place in the line, or on a lane, as long as the block lasts.

        in_place_of: a job that is to be cancelled inside; it does not count as one ahead

        Raises:
            NotReady, Overloaded: as `submit`.
        """
        with self._changed:
            if not self._takes_jobs:
                raise NotReady("the service is stopping")
            leaves = in_place_of is not None and not in_place_of.has_ended
            waiting = self._count_waiting()
            self._check_room(waiting + self._busy_lanes - leaves)
            ahead = waiting if in_place_of is None else self._count_waiting(but=in_place_of)
            self._check_worth_waiting(job, ahead=ahead)
            job.submitted = self._clock()
            self._line.add(job)
            self._awaited.add(job)
            self._changed.notify()
        try:
            yield
        finally:
            job.cancel(JobCancelled())
            with self._changed:
                self._line.discard(job)
                self._awaited.discard(job)

    async def result_of(self, job: Job[Result]) -> Result:
        """What an admitted job's work returns. Raises `DeadlineExceeded`: the budget ran out."""
        loop = asyncio.get_running_loop()
        budget_ms = job.budget_ms
        alarm = (
            None
            if budget_ms is None
            else loop.call_later(job.arrival.left_ms(budget_ms) / 1e3, job.expire)
        )
        try:
            return await asyncio.wrap_future(job.result)
        finally:
            if alarm is not None:
                alarm.cancel()

    def cancel_all(self) -> None:
        """Refuse all that waits, all that is worked on and all that comes, as `not_ready`."""
        with self._changed:
            self._takes_jobs = False
            awaited = list(self._awaited)
        for job in awaited:
            job.cancel(NotReady("the service is stopping"))

    def __enter__(self) -> PlanningQueue:
        self._is_open = self._takes_jobs = True
        self._lanes = [
            threading.Thread(target=self._work_on, name=f"planning-{lane}", daemon=True)
            for lane in range(self.num_lanes)
        ]
        for lane in self._lanes:
            lane.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Refuse what waits, and wait for what is worked on."""
        with self._changed:
            self._is_open = self._takes_jobs = False
            left = [*self._line.clear(), *(assignment.job for assignment in self._batch)]
            self._batch.clear()
            self._changed.notify_all()
        for job in left:
            job.cancel(NotReady("the service is stopping"))
        for lane in self._lanes:
            lane.join()

    def _work_on(self) -> None:
        """What a lane does, until the queue closes."""
        while (assignment := self._next()) is not None:
            job, threads = assignment
            began = self._clock()
            wait_ms = (began - job.submitted) * 1e3
            job.run(queue_ms=wait_ms, threads=threads, freed=partial(self._free, began))

    def _free(self, began: float, was_done: bool) -> None:
        """A lane is free that was taken at that time [s]."""
        with self._changed:
            self._busy_lanes -= 1
            if was_done:
                self._service_time.observe(self._clock() - began)

    def _next(self) -> _Assignment | None:
        """The next job for a lane; None once the queue is closed."""
        with self._changed:
            while not self._batch:
                if not self._is_open:
                    return None
                wait_s = self._form_batch()
                if not self._batch:
                    self._changed.wait(wait_s)
            self._busy_lanes += 1
            return self._batch.popleft()

    def _form_batch(self) -> float | None:
        """Make the head of the line the batch; or say how long [s] others may still join it."""
        jobs = self._line.batch(self._limits.max_batch)
        if not jobs:
            return None
        wait_s = self._limits.batch_wait_ms / 1e3 - (self._clock() - jobs[0].submitted)
        if len(jobs) < self._limits.max_batch and wait_s > 0:
            return wait_s
        self._line.remove(jobs)
        self._on_batch(len(jobs))
        idle_lanes = self.num_lanes - self._busy_lanes
        threads = idle_lanes * self._num_threads // (self.num_lanes * len(jobs))
        self._batch.extend(_Assignment(job, max(1, threads)) for job in jobs)
        # One for each job that this lane leaves, and one for what still waits.
        self._changed.notify(len(jobs) - 1 + (self._line.first is not None))
        return None

    def _count_waiting(self, *, but: AnyJob | None = None) -> int:
        left = sum(job is not but for job in self._left_in_batch())
        return self._line.count(but=but) + left

    def _left_in_batch(self) -> Iterator[AnyJob]:
        """Jobs of the batch that no lane has taken yet."""
        return (each.job for each in self._batch if not each.job.has_ended)

    def _check_room(self, held: int, max_waiting: int | None = None) -> None:
        """Raises `Overloaded` where so many already hold all places."""
        waiting = held - self.num_lanes
        if waiting >= (self._limits.max_waiting if max_waiting is None else max_waiting):
            raise self._overloaded(f"{waiting} requests wait already", held)

    def _check_worth_waiting(self, job: AnyJob, *, ahead: int) -> None:
        """Raises `Overloaded` where those ahead and the job itself likely outlast its budget.

        A job with nobody ahead is never refused: it is what the estimate learns from.
        """
        if job.budget_ms is None or not ahead:
            return
        likely_ms = self._service_time.wait_s(ahead + self.num_lanes) * 1e3
        if likely_ms > job.arrival.left_ms(job.budget_ms):
            wait = f"{ahead} requests wait already, an answer would take about {likely_ms:.0f} ms"
            raise self._overloaded(f"{wait} of a budget of {job.budget_ms:g} ms", ahead)

    def _overloaded(self, message: str, ahead: int) -> Overloaded:
        wait_s = self._service_time.retry_after_s(ahead)
        return Overloaded(f"{message}; try again in {wait_s} s", retry_after_s=wait_s)
