"""The queue in front of the engines: admission, micro-batches, and the lanes that work on them.

A lane is a thread that works on one request at a time; nothing blocks the event loop. A lane that
gets free takes the oldest waiting request and with it, as a batch, those that fit to it. The lanes
share a batch, one thread for each request; a request that finds other lanes idle has their threads
too.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import NamedTuple, TypeVar

from anchorflow_client.errors import NotReady, Overloaded
from anchorflow_service.cores import usable_cores
from anchorflow_service.planning.arrival import Arrival
from anchorflow_service.planning.job import CalledOff, Ticket, Turn
from anchorflow_service.planning.limits import ServiceLimits
from anchorflow_service.planning.service_time import Pace
from anchorflow_service.planning.waiting import AnyTicket, WaitingLine

Result = TypeVar("Result")


class _Assignment(NamedTuple):
    ticket: AnyTicket
    threads: int


class PlanningQueue:
    """Works on as many tickets at a time as it has lanes, lets so many wait, refuses the rest.

    Open inside its `with` block only.

    Args:
        limits: bounds on waiting and on batches.
        clock: seconds, for the time in the queue and the pace.
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
        self.workers = min(self._num_threads, limits.max_batch)
        """Lanes."""
        self.in_flight = 0
        """Requests that hold a place: read, wait, or are worked on."""
        self._pace = Pace(self.workers)
        # Guards all that follows; lanes wait on it for tickets.
        self._changed = threading.Condition()
        self._line = WaitingLine()
        self._batch: deque[_Assignment] = deque()
        self._awaited: set[AnyTicket] = set()
        self._idle_lanes = self._busy_lanes = 0
        self._lanes: list[threading.Thread] = []
        self._is_open = False

    @property
    def is_open(self) -> bool:
        """Whether it takes tickets."""
        return self._is_open

    @property
    def mean_service_s(self) -> float:
        """Running mean of the time that a request takes a lane; 0 before the first."""
        return self._pace.mean_s

    @contextmanager
    def place(self, *, beyond: int = 0) -> Iterator[None]:
        """One of the places of those who wait or are worked on, as long as the block lasts.

        beyond: so many more may be inside, to be read and perhaps refused by `work`

        Raises:
            NotReady: the queue is not open.
            Overloaded: no place is free, with the time until one likely is.
        """
        if not self._is_open:
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
    def oldest_wait_s(self) -> float:
        """How long the oldest that no lane has taken has waited; 0 where nobody waits."""
        with self._changed:
            # A batch stood before all that is in the line.
            first = next(self._left_in_batch(), self._line.first)
            return 0.0 if first is None else self._clock() - first.submitted

    async def run(self, job: Callable[[Turn], Result]) -> Result:
        """What a job that is no request returns; it takes a place, and a lane to itself.

        Raises:
            NotReady, Overloaded: as `place`.
        """
        with self.place():
            return await self.work(Ticket(job, Arrival(clock=self._clock)))

    async def work(self, ticket: Ticket[Result]) -> Result:
        """What the ticket's job returns; whoever cancels this calls the ticket off.

        Raises:
            NotReady: the queue is closing.
            Overloaded: too many wait, or likely take longer than the ticket's budget.
            DeadlineExceeded: the budget ran out.
        """
        with self._changed:
            if not self._is_open:
                raise NotReady("the service is stopping")
            self._check_room(self._waiting() + self._busy_lanes)
            self._check_worth_waiting(ticket)
            ticket.submitted = self._clock()
            self._line.add(ticket)
            self._awaited.add(ticket)
            self._changed.notify()
        loop = asyncio.get_running_loop()
        budget_ms = ticket.budget_ms
        alarm = (
            None
            if budget_ms is None
            else loop.call_later(ticket.arrival.left_ms(budget_ms) / 1e3, ticket.run_out)
        )
        try:
            return await asyncio.wrap_future(ticket.result)
        finally:
            if alarm is not None:
                alarm.cancel()
            ticket.call_off(CalledOff())
            with self._changed:
                self._line.discard(ticket)
                self._awaited.discard(ticket)

    def break_off(self) -> None:
        """Refuse all that waits and all that is worked on, as `not_ready`."""
        with self._changed:
            awaited = list(self._awaited)
        for ticket in awaited:
            ticket.call_off(NotReady("the service is stopping"))

    def __enter__(self) -> PlanningQueue:
        self._is_open = True
        self._lanes = [
            threading.Thread(target=self._work_on, name=f"planning-{lane}", daemon=True)
            for lane in range(self.workers)
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
            self._is_open = False
            left = [*self._line.clear(), *(assignment.ticket for assignment in self._batch)]
            self._batch.clear()
            self._changed.notify_all()
        for ticket in left:
            ticket.call_off(NotReady("the service is stopping"))
        for lane in self._lanes:
            lane.join()

    def _work_on(self) -> None:
        """What a lane does, until the queue closes."""
        while (assignment := self._next()) is not None:
            ticket, threads = assignment
            began = self._clock()
            was_done = ticket.work(queue_ms=(began - ticket.submitted) * 1e3, threads=threads)
            with self._changed:
                self._busy_lanes -= 1
                if was_done:
                    self._pace.observe(self._clock() - began)

    def _next(self) -> _Assignment | None:
        """The next ticket for a lane; None once the queue is closed."""
        with self._changed:
            self._idle_lanes += 1
            try:
                while not self._batch:
                    if not self._is_open:
                        return None
                    wait_s = self._form_batch()
                    if not self._batch:
                        self._changed.wait(wait_s)
                self._busy_lanes += 1
                return self._batch.popleft()
            finally:
                self._idle_lanes -= 1

    def _form_batch(self) -> float | None:
        """Make the head of the line the batch; or say how long [s] others may still join it."""
        tickets = self._line.batch(self._limits.max_batch)
        if not tickets:
            return None
        waited_s = self._clock() - tickets[0].submitted
        wait_s = self._limits.batch_wait_ms / 1e3 - waited_s
        if len(tickets) < self._limits.max_batch and wait_s > 0:
            return wait_s
        self._line.remove(tickets)
        self._on_batch(len(tickets))
        threads = self._idle_lanes * self._num_threads // (self.workers * len(tickets))
        self._batch.extend(_Assignment(ticket, max(1, threads)) for ticket in tickets)
        # One for each ticket that this lane leaves, and one for what still waits.
        self._changed.notify(len(tickets))
        return None

    def _waiting(self) -> int:
        """Those that somebody waits for and no lane has taken."""
        return self._line.count() + sum(1 for _ in self._left_in_batch())

    def _left_in_batch(self) -> Iterator[AnyTicket]:
        """Of those, the ones that have left the line as part of a batch."""
        return (each.ticket for each in self._batch if not each.ticket.has_ended)

    def _check_room(self, held: int, max_waiting: int | None = None) -> None:
        """Raises `Overloaded` where so many already hold all places."""
        waiting = held - self.workers
        if waiting >= (self._limits.max_waiting if max_waiting is None else max_waiting):
            raise self._overloaded(f"{waiting} requests wait already", held)

    def _check_worth_waiting(self, ticket: AnyTicket) -> None:
        """Raises `Overloaded` where those ahead and the ticket itself likely outlast its budget.

        Who has nobody ahead is never refused: it is his request that teaches the pace.
        """
        ahead = self._waiting()
        if ticket.budget_ms is None or not ahead:
            return
        likely_ms = self._pace.wait_s(ahead + self.workers) * 1e3
        if likely_ms > ticket.arrival.left_ms(ticket.budget_ms):
            wait = f"{ahead} requests wait already, an answer would take about {likely_ms:.0f} ms"
            raise self._overloaded(f"{wait} of a budget of {ticket.budget_ms:g} ms", ahead)

    def _overloaded(self, message: str, ahead: int) -> Overloaded:
        wait_s = self._pace.retry_after_s(ahead)
        return Overloaded(f"{message}; try again in {wait_s} s", retry_after_s=wait_s)
