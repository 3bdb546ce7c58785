"""One query of one replica: what is sent, and what came back."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import zenoh

from anchorflow_client.codec import Payload
from anchorflow_client.contract.ranges import BUDGET
from anchorflow_client.errors import InvalidAnswer, RequestError
from anchorflow_client.zenoh_client.deadline import Deadline
from anchorflow_client.zenoh_client.network import translated
from anchorflow_client.zenoh_client.replicas import Replica
from anchorflow_client.zenoh_messages import AnswerAttachment, Load, RequestAttachment

SETTLE_S = 0.3
"""How long after a query came back empty the replica's death may take to be known."""


@dataclass(frozen=True)
class Question:
    """What is asked."""

    payload: Payload
    content_type: str
    request_id: str
    model: str | None
    deadline: Deadline


@dataclass
class Attempt:
    """A query on its way."""

    replica: Replica
    model: str
    key: str
    patience_s: float
    """How long it is waited for alone."""
    sent: float = field(default_factory=time.monotonic)
    is_late: bool = False
    _cancellation: zenoh.CancellationToken = field(
        init=False, default_factory=zenoh.CancellationToken
    )

    def send(
        self,
        session: zenoh.Session,
        question: Question,
        hand_over: Callable[[zenoh.Reply | None], object],
    ) -> None:
        """Send it.

        Args:
            session: on the network.
            question: what to ask.
            hand_over: gets the reply, and None at the query's end, on zenoh's own thread.

        Raises:
            Cancelled: the request was taken back, or the session was closed.
        """
        left_s = question.deadline.left_s
        attachment = RequestAttachment(
            header_length=question.payload.header_length,
            request_id=question.request_id,
            # Whatever becomes of this client, the service drops the request by its own clock.
            budget_ms=min(left_s * 1e3, BUDGET.high),
        )
        handler = zenoh.handlers.Callback(hand_over, lambda: hand_over(None), indirect=False)
        with translated(question.deadline):
            session.get(
                self.key,
                handler,
                payload=question.payload.body,
                encoding=question.content_type,
                attachment=attachment.to_bytes(),
                timeout=left_s + SETTLE_S,
                express=True,
                congestion_control=zenoh.CongestionControl.BLOCK,
                cancellation_token=self._cancellation,
            )

    def cancel(self) -> None:
        """Wait for it no longer: nothing more is handed over. The replica is not told."""
        self._cancellation.cancel()


def answer_of(sample: zenoh.Sample) -> tuple[Payload, Load]:
    """The answer's bytes, and the replica's load. Raises `InvalidAnswer`."""
    attachment = None if sample.attachment is None else sample.attachment.to_bytes()
    said = AnswerAttachment.from_bytes(attachment)
    return Payload(sample.payload.to_bytes(), said.header_length), said.load


def refusal_of(data: bytes) -> RequestError:
    """The service's own words. Raises `InvalidAnswer` where they are not the contract's."""
    try:
        return RequestError.from_dict(json.loads(data.decode()))
    except (ValueError, RecursionError) as error:
        raise InvalidAnswer(f"an error that is not the contract's: {data[:80]!r}") from error
