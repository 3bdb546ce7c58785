"""The way from a request's bytes to its answer's."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Hashable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from types import TracebackType
from typing import TypeVar

from anchorflow_client.codec import Payload
from anchorflow_client.contract import (
    AnchorRequest,
    ResolvedRequest,
    resolve_for_card,
)
from anchorflow_client.errors import InternalError, InvalidRequest, NotReady, RequestError
from anchorflow_service.planning.arrival import Arrival
from anchorflow_service.planning.call import Call
from anchorflow_service.planning.engines import EngineRegistry, PlanningEngine
from anchorflow_service.planning.job import Job, JobContext
from anchorflow_service.planning.latest_per_robot import LatestPerRobot
from anchorflow_service.planning.limits import ServiceLimits
from anchorflow_service.planning.observer import ANSWERED, CANCELLED, Observer
from anchorflow_service.planning.queue import PlanningQueue

Result = TypeVar("Result")

QUICK_BYTES = 256 * 2**10
"""Of a request: to read so many takes milliseconds; in binary less than to hand them to a thread
and back."""


class PlanningService:
    """Plans what calls ask for, off the event loop; open inside its `with` block only.

    Args:
        engines: by the name that a request's `model` gives.
        default: the name that stands in where a request gives none.
        limits: bounds on memory, on waiting and on what is done at a time.
        clock: seconds, for arrivals and for the time in the queue.

    Raises:
        ValueError: `default` is not among the engines.
    """

    def __init__(
        self,
        engines: Mapping[str, PlanningEngine],
        *,
        default: str,
        limits: ServiceLimits | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self.limits = limits or ServiceLimits()
        self.engines = EngineRegistry(engines, default=default)
        self.queue = PlanningQueue(self.limits, clock=clock, on_batch=self._batch_planned)
        self._observers: list[Observer] = []
        self._is_leaving = False
        self._latest = LatestPerRobot()
        self._clock = clock
        # Parsing holds the interpreter's lock: more readers would only get in each other's way.
        self._reader: ThreadPoolExecutor | None = None
        self._large_reader: ThreadPoolExecutor | None = None

    def arrival(self) -> Arrival:
        """A request comes in now."""
        return Arrival(clock=self._clock)

    @property
    def is_ready(self) -> bool:
        """Whether new callers should come."""
        return self.queue.is_open and not self._is_leaving

    def check_ready(self) -> None:
        """Raises `NotReady` where new callers should not come."""
        if not self.is_ready:
            raise NotReady("the service is starting or stopping")

    def leave(self) -> None:
        """Tell whoever asks that it is not ready; requests that come are still answered."""
        self._is_leaving = True

    def watch(self, observer: Observer) -> None:
        """From now on it hears what becomes of every call."""
        self._observers.append(observer)

    async def answer(self, call: Call) -> Payload:
        """The answer's bytes, in the form of the request's.

        A caller who leaves cancels this: what waits is dropped, and what is planned ends within
        one step of the solver. So does what runs out of its budget or is superseded.

        Raises:
            RequestError: the request is refused, or its budget is spent.
        """
        # A place first: whom the service has no room for costs it no reading. Unless robots are
        # named: one of them may be inside already, and its older request makes room for this one.
        beyond = self.limits.max_waiting if self._latest else 0
        with self._observed(call), self.queue.place(beyond=beyond):
            engine, request = await self.reading(call.payload, partial(self._read, call))
            call.arrival.check(request.budget_ms, "before planning")
            job = Job(
                partial(_plan, engine, request, call),
                call.arrival,
                budget_ms=request.budget_ms,
                key=_batch_key(engine, request),
                deliver=call.deliver,
            )
            robot_id = request.robot_id
            older = self._latest.standing(robot_id, job)
            # Admitted first: what is refused supersedes nobody.
            with (
                self.queue.admitted(job, in_place_of=older),
                self._latest.registered(robot_id, job),
            ):
                return await self.queue.result_of(job)

    async def reading(self, payload: Payload, read: Callable[[], Result]) -> Result:
        """What reading a payload gives: off the event loop unless that is quick, and no small one
        behind a large one.
        """
        is_small = len(payload.body) <= QUICK_BYTES
        if is_small and payload.header_length is not None:
            return read()
        reader = self._reader if is_small else self._large_reader
        return await asyncio.get_running_loop().run_in_executor(reader, read)

    def __enter__(self) -> PlanningService:
        self._reader = ThreadPoolExecutor(1, thread_name_prefix="reading")
        self._large_reader = ThreadPoolExecutor(1, thread_name_prefix="reading-large")
        self.queue.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.queue.__exit__(kind, error, traceback)
        for reader in (self._reader, self._large_reader):
            if reader is not None:
                reader.shutdown()

    @contextmanager
    def _observed(self, call: Call) -> Iterator[None]:
        outcome = InternalError.code
        try:
            yield
            outcome = ANSWERED
        except RequestError as error:
            outcome = error.code
            raise
        except asyncio.CancelledError:
            outcome = CANCELLED
            raise
        finally:
            for observer in self._observers:
                observer.ended(call, outcome)

    def _batch_planned(self, requests: int) -> None:
        for observer in self._observers:
            observer.batch_planned(requests)

    def _read(self, call: Call) -> tuple[PlanningEngine, ResolvedRequest]:
        """What a call asks, of whom. Megabytes of numbers, or numbers in words, take a while to
        check, against the card too: off the event loop with them.
        """
        asked = call.codec.decode_request(call.payload)
        call.request_id = asked.request_id or call.request_id
        engine = self.engines.choose(_model(call, asked))
        call.model_id = engine.card.id
        return engine, _with_call(resolve_for_card(asked, engine.card), call)


def _plan(
    engine: PlanningEngine, request: ResolvedRequest, call: Call, context: JobContext
) -> Payload:
    """What a lane does: plan, and write the answer too, which may hold millions of numbers."""
    batch = engine.plan(request, threads=context.threads, check=context.check)
    context.check()
    timing_ms = {**batch.timing_ms, "queue": context.queue_ms, "total": call.arrival.elapsed_ms}
    call.timing_ms = timing_ms
    answer = batch.told(timing_ms=timing_ms, request_id=request.request_id)
    return call.codec.encode_answer(answer)


def _batch_key(engine: PlanningEngine, request: ResolvedRequest) -> Hashable:
    """Requests of the same key take about as long: same bundle, sampler, anchors and scenes."""
    tau = request.warm_start and request.warm_start.tau
    return (id(engine), request.sampler, tau, request.num_samples, request.num_scenes)


def _model(call: Call, asked: AnchorRequest) -> str | None:
    if call.model is None or asked.model in (None, call.model):
        return call.model or asked.model
    raise InvalidRequest(f"expected {call.model}, as the address says, got {asked.model}", "model")


def _with_call(resolved: ResolvedRequest, call: Call) -> ResolvedRequest:
    budget_ms = resolved.budget_ms if call.budget_ms is None else call.budget_ms
    return replace(resolved, request_id=call.request_id, budget_ms=budget_ms)
