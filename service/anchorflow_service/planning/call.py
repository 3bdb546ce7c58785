"""A call: a request as its transport received it, its deadline, and who observes its outcome."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

from anchorflow_client.codec import Payload
from anchorflow_client.contract import AnchorBatch, AnchorRequest, ModelId
from anchorflow_client.errors import DeadlineExceeded, InternalError

ANSWERED = "ok"
CANCELLED = "cancelled"
"""Outcomes beside the codes of the contract's errors."""


class Arrival:
    """The time at which a request arrived, from which its budget counts."""

    def __init__(self, *, clock: Callable[[], float] = time.perf_counter) -> None:
        self._clock = clock
        self._arrived = clock()

    @property
    def elapsed_ms(self) -> float:
        """Return the time since then."""
        return (self._clock() - self._arrived) * 1e3

    def is_after(self, other: Arrival) -> bool:
        """Return whether this request is the newer one."""
        return self._arrived > other._arrived

    def left_ms(self, budget_ms: float) -> float:
        """Return what remains of a budget, at least 0."""
        return max(0.0, budget_ms - self.elapsed_ms)

    def check(self, budget_ms: float | None, stage: str) -> None:
        """Raise `DeadlineExceeded`, naming the stage, if the budget is spent."""
        if budget_ms is not None and self.elapsed_ms >= budget_ms:
            raise self.exceeded(budget_ms, stage)

    def exceeded(self, budget_ms: float, stage: str) -> DeadlineExceeded:
        """Return the error of a request whose budget is spent."""
        message = f"expected an answer within {budget_ms:g} ms, {self.elapsed_ms:.1f} ms had passed"
        return DeadlineExceeded(f"{message} {stage}", "budget_ms")


class ServiceCodec(Protocol):
    """The service's half of a codec."""

    def decode_request(self, payload: Payload) -> AnchorRequest:
        """Read a request. Raises `InvalidRequest`."""
        ...

    def encode_answer(self, batch: AnchorBatch) -> Payload:
        """Write an answer. Raises `ValueError` if a number is not finite."""
        ...


@dataclass
class Call:
    """A request as its transport received it: its bytes, and fields sent beside them."""

    payload: Payload
    codec: ServiceCodec
    """Reads the request and writes the answer."""
    arrival: Arrival
    request_id: str
    """Used if the request has no id of its own, which replaces it once the request is read."""
    model: str | None = None
    """The model that the address names, if any."""
    budget_ms: float | None = None
    """A budget from beside the bytes; it overrides the one inside them."""
    transport: str = "http"
    deliver: Callable[[Payload], object] | None = None
    """Takes the answer on the planning thread, for transports that can send from any thread: the
    answer then need not wait for the event loop."""
    model_id: ModelId | None = field(default=None, init=False)
    """The model that was chosen."""
    timing_ms: Mapping[str, float] = field(default_factory=dict, init=False)
    """Durations of the answer's stages."""


class Observer:
    """Is told of every call on every transport; a subclass overrides what it needs.

    A method may be called from any thread, and must neither block nor fail.
    """

    def ended(self, call: Call, outcome: str) -> None:
        """Handle the end of a call: `ANSWERED`, `CANCELLED` or an error's code.

        An answered call has `model_id` and `timing_ms`.
        """

    def batch_planned(self, requests: int) -> None:
        """Handle a micro-batch of that many requests."""


def internal_error(request_id: str) -> InternalError:
    """Return the error for an unexpected exception, which only the log describes."""
    return InternalError(f"internal error; the log tells of request {request_id}")
