"""A call: a request as its transport received it, and what becomes known of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

from anchorflow_client.codec import Payload
from anchorflow_client.contract import AnchorBatch, AnchorRequest, ModelId
from anchorflow_service.planning.arrival import Arrival


class ServiceCodec(Protocol):
    """The half of a codec that a service needs."""

    def decode_request(self, payload: Payload) -> AnchorRequest:
        """What a service received. Raises `InvalidRequest`."""
        ...

    def encode_answer(self, batch: AnchorBatch) -> Payload:
        """What a service sends. Raises `ValueError` where a number is not finite."""
        ...


@dataclass
class Call:
    """A request as its transport received it: the bytes, and what was said beside them."""

    payload: Payload
    codec: ServiceCodec
    """Reads the request and writes the answer."""
    arrival: Arrival
    request_id: str
    """Stands in where the request has none of its own, which takes its place once it is read."""
    model: str | None = None
    """The one that the address names, where it names one."""
    budget_ms: float | None = None
    """Said beside the bytes, and newer than the one inside them."""
    transport: str = "http"
    deliver: Callable[[Payload], object] | None = None
    """Takes the answer on the thread that planned it, where a transport can send from any thread:
    so nobody waits for the event loop, which hears of it too."""
    model_id: ModelId | None = field(default=None, init=False)
    """Of the model that was chosen for it."""
    timing_ms: Mapping[str, float] = field(default_factory=dict, init=False)
    """Of its answer, by stage."""
