"""The engines of a service, and the path from a request's bytes to its answer's."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Hashable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Any, Protocol, TypeVar

from anchorflow_client.codec import Payload
from anchorflow_client.contract import (
    AnchorBatch,
    AnchorRequest,
    ModelCard,
    ResolvedRequest,
    resolve_for_card,
)
from anchorflow_client.contract.fields import DEFAULT_MODEL
from anchorflow_client.errors import (
    InternalError,
    InvalidRequest,
    NotReady,
    RequestError,
    Superseded,
    UnknownModel,
)
from anchorflow_service.planning.job import (
    ANSWERED,
    CANCELLED,
    AnyJob,
    Arrival,
    Call,
    Job,
    JobContext,
    Observer,
)
from anchorflow_service.planning.queue import PlanningQueue, ServiceLimits


class PlanningEngine(Protocol):
    """A loaded model."""

    @property
    def card(self) -> ModelCard:
        """Return the model's card."""
        ...

    def plan(
        self, request: ResolvedRequest, /, *, threads: int, check: Callable[[], object]
    ) -> AnchorBatch:
        """Plan anchors for every scene of a request resolved for the card. Blocks; thread-safe.

        The answer depends neither on `threads`, the number of threads it may use, nor on other
        requests. `check` is called between steps; its exceptions end the work.

        Raises:
            RequestError: the engine cannot honour the request.
        """
        ...


class EngineRegistry:
    """Engines by model name, one of them the default; they may change while requests arrive.

    A request keeps the engine that it chose, so that a change fails no request.
    """

    def __init__(self, engines: Mapping[str, PlanningEngine], *, default: str) -> None:
        """Raises `ValueError` if the default is not among the engines."""
        if default not in engines:
            raise ValueError(f"the default model {default!r} is none of {sorted(engines)}")
        # Replaced as a whole, never modified, so that reading needs no lock.
        self._engines = dict(engines)
        self.default = default
        """Used if a request names no model; it may have been removed."""
        self._changing = threading.Lock()
        self._followers: list[Callable[[], None]] = []

    def choose(self, model: str | None) -> PlanningEngine:
        """Return the engine of that model, or the default. Raises `UnknownModel`."""
        if model == DEFAULT_MODEL and model not in self._engines:
            model = None
        name = self.default if model is None else model
        engine = self._engines.get(name)
        if engine is None:
            served = ", ".join(sorted(self._engines)) or "none at present"
            which = f"the default, {name!r}" if model is None else repr(name)
            raise UnknownModel(f"expected a model that is served ({served}), got {which}", "model")
        return engine

    def put(self, engine: PlanningEngine) -> None:
        """Serve the engine under the model name of its card."""
        with self._changing:
            self._engines = {**self._engines, engine.card.name: engine}
        self._notify()

    def remove(self, model: str) -> None:
        """Stop serving that model. Raises `UnknownModel`."""
        with self._changing:
            self.choose(model)
            self._engines = {name: each for name, each in self._engines.items() if name != model}
        self._notify()

    @contextmanager
    def followed_by(self, follower: Callable[[], None]) -> Iterator[None]:
        """Call the follower after every change inside the block, on the thread of the change."""
        self._followers.append(follower)
        try:
            yield
        finally:
            self._followers.remove(follower)

    def cards(self) -> list[ModelCard]:
        """Return all cards, the default model's first."""
        engines = self._engines
        names = sorted(engines, key=lambda name: (name != self.default, name))
        return [engines[name].card for name in names]

    def _notify(self) -> None:
        for follower in list(self._followers):
            follower()


Result = TypeVar("Result")

QUICK_BYTES = 256 * 2**10
"""A smaller binary request is decoded faster than it is passed to a thread and back."""


class LatestPerRobot:
    """The newest job of each robot while it waits or runs; a newer one cancels it.

    Not thread-safe: it belongs to the event loop.
    """

    def __init__(self) -> None:
        self._newest: dict[str, AnyJob] = {}

    def __len__(self) -> int:
        """Return the number of robots that wait for an answer."""
        return len(self._newest)

    def standing(self, robot_id: str | None, job: AnyJob) -> AnyJob | None:
        """Return the robot's older job. Raises `Superseded` if this one is the older."""
        if robot_id is None:
            return None
        standing = self._newest.get(robot_id)
        if standing is not None and standing.arrival.is_after(job.arrival):
            raise _superseded(robot_id)
        return standing

    @contextmanager
    def registered(self, robot_id: str | None, job: AnyJob) -> Iterator[None]:
        """Register the job inside the block; cancel the robot's older one. Raises `Superseded`."""
        if robot_id is None:
            yield
            return
        if (standing := self.standing(robot_id, job)) is not None:
            standing.cancel(_superseded(robot_id))
        self._newest[robot_id] = job
        try:
            yield
        finally:
            if self._newest.get(robot_id) is job:
                del self._newest[robot_id]


class PlanningService:
    """Answers calls with anchors, off the event loop; open inside its `with` block only.

    Args:
        engines: by model name.
        default: the model of requests that name none. Raises `ValueError` if it is no engine's.
        limits: bounds on memory, on waiting and on concurrent work.
        clock: seconds, for arrivals and for the time in the queue.
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
        # Parsing holds the interpreter's lock, so more readers would be no faster.
        self._reader: ThreadPoolExecutor | None = None
        self._large_reader: ThreadPoolExecutor | None = None

    def arrival(self) -> Arrival:
        """Note that a request arrives now."""
        return Arrival(clock=self._clock)

    @property
    def is_ready(self) -> bool:
        """Return whether new requests should be sent here."""
        return self.queue.is_open and not self._is_leaving

    def check_ready(self) -> None:
        """Raise `NotReady` if new requests should not be sent here."""
        if not self.is_ready:
            raise NotReady("the service is starting or stopping")

    def leave(self) -> None:
        """Turn `is_ready` false; requests are still answered."""
        self._is_leaving = True

    def watch(self, observer: Observer) -> None:
        """Add an observer of all calls."""
        self._observers.append(observer)

    async def answer(self, call: Call) -> Payload:
        """Return the answer's bytes, in the form of the request.

        Cancel this if the caller disconnects: a waiting request is dropped, and one that is being
        planned ends within one step of the solver, as if its budget ran out or it was superseded.

        Raises:
            RequestError: the request is refused, or its budget is spent.
        """
        # Take a place before reading, so that a refused request costs nothing. If robots are known,
        # read it anyway: it may replace an older request of the same robot.
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
            # Admit it first: a refused request supersedes none.
            with (
                self.queue.admitted(job, in_place_of=older),
                self._latest.registered(robot_id, job),
            ):
                return await self.queue.result_of(job)

    async def reading(self, payload: Payload, read: Callable[[], Result]) -> Result:
        """Decode a payload, off the event loop unless that is quick; small ones overtake large."""
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

    def __exit__(self, *error: Any) -> None:
        self.queue.__exit__(*error)
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
        """Decode a call, choose its engine, and resolve the request for the engine's card."""
        asked = call.codec.decode_request(call.payload)
        call.request_id = asked.request_id or call.request_id
        engine = self.engines.choose(_model(call, asked))
        call.model_id = engine.card.id
        return engine, _with_call(resolve_for_card(asked, engine.card), call)


def _plan(
    engine: PlanningEngine, request: ResolvedRequest, call: Call, context: JobContext
) -> Payload:
    """Plan and encode the answer, on a lane: it may hold millions of numbers."""
    batch = engine.plan(request, threads=context.threads, check=context.check)
    context.check()
    timing_ms = {**batch.timing_ms, "queue": context.queue_ms, "total": call.arrival.elapsed_ms}
    call.timing_ms = timing_ms
    answer = batch.told(timing_ms=timing_ms, request_id=request.request_id)
    return call.codec.encode_answer(answer)


def _batch_key(engine: PlanningEngine, request: ResolvedRequest) -> Hashable:
    """Return a key that is equal for requests that take about equally long."""
    tau = request.warm_start and request.warm_start.tau
    return (id(engine), request.sampler, tau, request.num_samples, request.num_scenes)


def _model(call: Call, asked: AnchorRequest) -> str | None:
    if call.model is None or asked.model in (None, call.model):
        return call.model or asked.model
    raise InvalidRequest(f"expected {call.model}, as the address says, got {asked.model}", "model")


def _with_call(resolved: ResolvedRequest, call: Call) -> ResolvedRequest:
    budget_ms = resolved.budget_ms if call.budget_ms is None else call.budget_ms
    return replace(resolved, request_id=call.request_id, budget_ms=budget_ms)


def _superseded(robot_id: str) -> Superseded:
    return Superseded(f"a newer request of robot_id {robot_id!r} took this one's place", "robot_id")
