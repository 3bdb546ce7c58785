"""Send one request to one replica after another, until one answers or the time is up."""

from __future__ import annotations

import json
import logging
import queue
import time
from dataclasses import dataclass, field

import zenoh

from anchorflow_client.cancellation import Deadline
from anchorflow_client.codec import Payload
from anchorflow_client.contract.fields import BUDGET
from anchorflow_client.errors import (
    AnchorFlowError,
    ConnectionFailed,
    InvalidAnswer,
    NotReady,
    Overloaded,
    RequestError,
    TimedOut,
    Unauthorized,
    UnknownModel,
)
from anchorflow_client.zenoh_client.network import TIMEOUT, Network, translated
from anchorflow_client.zenoh_client.replicas import Choice, Replica
from anchorflow_client.zenoh_messages import (
    AnswerAttachment,
    Load,
    RequestAttachment,
    replica_anchors_key,
)

SETTLE_S = 0.3
"""How long after an empty reply the replica's death may take to be known."""
HEDGE_SHARE = 0.5
"""Share of the time left after which another replica is queried beside a silent one."""

logger = logging.getLogger(__name__)

_Event = tuple[str, zenoh.Reply | None] | None
"""A replica with its reply, or with None at its query's end; None alone: the request was cancelled.
"""


@dataclass(frozen=True)
class EncodedRequest:
    """A request in the form in which every replica receives it."""

    payload: Payload
    content_type: str
    request_id: str
    model: str | None
    deadline: Deadline


@dataclass
class Attempt:
    """A query to one replica."""

    replica: Replica
    model: str
    key: str
    patience_s: float
    """Time until another replica is queried beside this one."""
    sent: float = field(default_factory=time.monotonic)
    is_late: bool = False
    cancellation: zenoh.CancellationToken = field(default_factory=zenoh.CancellationToken)
    """Stops the callbacks; zenoh does not notify the replica."""


class Failover:
    """Queries replicas for one request. Used once, by one thread."""

    def __init__(self, network: Network, request: EncodedRequest) -> None:
        self._network = network
        self._replicas = network.replicas
        self._request = request
        self._events: queue.SimpleQueue[_Event] = queue.SimpleQueue()
        self._open: dict[str, Attempt] = {}
        self._tried: list[str] = []
        self._empty: dict[str, Attempt] = {}
        self._refusal: RequestError | None = None

    def run(self) -> Payload:
        """Return the answer's bytes.

        Raises:
            RequestError: a replica refuses; if it is overloaded, starting or without the model,
                all of them do.
            Unauthorized: replicas are alive, but the request does not reach them.
            ConnectionFailed: no replica is alive.
            TimedOut: no replica answered in time.
            Cancelled: the request was cancelled.
            InvalidAnswer: the answer breaks the contract.
        """
        try:
            with self._request.deadline.watched_by(lambda: self._events.put(None)):
                self._query_next()
                while (answer := self._step()) is None:
                    pass
                return answer
        finally:
            for attempt in list(self._open.values()):
                attempt.cancellation.cancel()
                self._close(attempt, None, failed=attempt.is_late)

    def _step(self) -> Payload | None:
        """Wait for one event and handle it."""
        left_s = self._request.deadline.left_s
        if not left_s:
            self._mark_late()
            raise self._timed_out()
        try:
            event = self._events.get(timeout=min(left_s, self._patience_s()))
        except queue.Empty:
            self._hedge()
            return None
        if event is None:  # the next step checks the deadline
            return None
        name, reply = event
        attempt = self._open.get(name)
        if attempt is None:  # its reply was handled already, and this is the query's end
            return None
        if reply is not None and reply.ok is not None:
            return self._read_answer(attempt, reply.ok)
        self._handle_failure(attempt, None if reply is None else reply.err)
        if all(each.is_late for each in self._open.values()):
            self._query_next()
        return None

    def _query_next(self) -> None:
        """Query the next replica, if there is one. Raises if no query is pending then."""
        if not self._request.deadline.left_s:
            raise self._timed_out()
        while (choice := self._choose()) is None:
            if self._open:
                return
            if not self._replicas.wait_for_change(self._tried, self._request.deadline):
                raise self._verdict()
        share_s = self._request.deadline.left_s * HEDGE_SHARE
        patience_s = max(share_s, 2e-3 * choice.expected_ms)
        name, key = choice.replica, replica_anchors_key(choice.replica, choice.model)
        attempt = Attempt(self._replicas.begin(name), choice.model, key, patience_s)
        self._tried.append(name)
        self._open[name] = attempt
        logger.debug("request %s: asking %s", self._request.request_id, name)
        self._send(attempt)

    def _send(self, attempt: Attempt) -> None:
        """Send the query; zenoh's thread puts its reply, and then its end, into the events."""
        request, name = self._request, attempt.replica.name
        left_s = request.deadline.left_s
        attachment = RequestAttachment(
            header_length=request.payload.header_length,
            request_id=request.request_id,
            # Zenoh does not report a client that died: the service drops the request by itself.
            budget_ms=min(left_s * 1e3, BUDGET.high),
        )

        def on_reply(reply: zenoh.Reply | None) -> None:
            self._events.put((name, reply))

        handler = zenoh.handlers.Callback(on_reply, lambda: on_reply(None), indirect=False)
        with translated(request.deadline):
            self._network.session.get(
                attempt.key,
                handler,
                payload=request.payload.body,
                encoding=request.content_type,
                attachment=attachment.to_bytes(),
                timeout=left_s + SETTLE_S,
                express=True,
                congestion_control=zenoh.CongestionControl.BLOCK,
                cancellation_token=attempt.cancellation,
            )

    def _choose(self) -> Choice | None:
        """Return the next replica. Raises `UnknownModel`."""
        model = self._request.model
        try:
            choice = self._replicas.choose(model, self._tried)
            if choice is None and not self._open and self._retry_after_unload():
                choice = self._replicas.choose(model, self._tried)
            return choice
        except UnknownModel:  # by the known infos; the model may have been loaded since
            if self._open:  # a replica that accepted the request earlier still answers
                return None
            self._network.query_again(self._request.deadline.at_most(SETTLE_S))
            return self._replicas.choose(model, self._tried)

    def _retry_after_unload(self) -> bool:
        """Make replicas untried whose model was unloaded; return whether there are any."""
        if self._empty:
            self._network.query_again(self._request.deadline.at_most(SETTLE_S))
        dropped = [
            name
            for name, attempt in self._empty.items()
            if self._replicas.has_dropped(name, attempt.model)
        ]
        for name in dropped:
            del self._empty[name]
            self._tried.remove(name)
        return bool(dropped)

    def _patience_s(self) -> float:
        """Return the time until another replica is queried beside the latest one."""
        if not self._open:
            return 0.0
        latest = max(self._open.values(), key=lambda attempt: attempt.sent)
        return max(0.0, latest.sent + latest.patience_s - time.monotonic())

    def _hedge(self) -> None:
        """Query another replica beside the late ones; the first answer counts."""
        if not self._request.deadline.left_s:
            return
        self._mark_late()
        late = ", ".join(self._open)
        logger.warning("request %s: %s has not answered yet", self._request.request_id, late)
        self._query_next()

    def _mark_late(self) -> None:
        for attempt in self._open.values():
            attempt.is_late, attempt.patience_s = True, float("inf")

    def _read_answer(self, attempt: Attempt, sample: zenoh.Sample) -> Payload:
        data = None if sample.attachment is None else sample.attachment.to_bytes()
        attachment = AnswerAttachment.from_bytes(data)
        payload = Payload(sample.payload.to_bytes(), attachment.header_length)
        self._close(attempt, attachment.load)
        logger.debug(
            "request %s: %s answered in %.1f ms",
            self._request.request_id,
            attempt.replica.name,
            (time.monotonic() - attempt.sent) * 1e3,
        )
        return payload

    def _handle_failure(self, attempt: Attempt, error: zenoh.ReplyError | None) -> None:
        """Note why this replica does not answer. Raises errors that all replicas would return."""
        request_id, name = self._request.request_id, attempt.replica.name
        data = None if error is None else error.payload.to_bytes()
        if data is None or data == TIMEOUT:
            self._close(attempt, None, failed=True)
            logger.warning("request %s: nothing came from %s", request_id, name)
            if data is None:
                self._empty[name] = attempt
            return
        refusal = _read_refusal(data)
        is_busy = isinstance(refusal, Overloaded | NotReady)
        self._close(attempt, None, failed=is_busy)
        if not is_busy and not isinstance(refusal, UnknownModel):
            raise refusal
        logger.warning("request %s: %s refused: %s", request_id, name, refusal)
        self._refusal = refusal

    def _close(self, attempt: Attempt, load: Load | None, *, failed: bool = False) -> None:
        del self._open[attempt.replica.name]
        self._replicas.end(attempt.replica, load, failed=failed)

    def _verdict(self) -> AnchorFlowError:
        """Return why no replica is left to query."""
        if self._refusal is not None:
            return self._refusal
        settled = self._request.deadline.at_most(SETTLE_S)
        denied = self._replicas.wait_until_gone(self._empty, settled)
        if denied and settled.timeout_s < SETTLE_S:  # too early to know whether they died
            return self._timed_out()
        if denied:
            keys = ", ".join(self._empty[name].key for name in denied)
            alive = f"{', '.join(denied)} is alive, and nothing comes back from {keys}"
            return Unauthorized(f"{alive}: access control denies it to this node")
        if self._empty:
            gone = ", ".join(self._empty)
            return ConnectionFailed(f"{gone} went away in mid-answer, and nobody else is there")
        return self._network.why_nobody(self._request.deadline)

    def _timed_out(self) -> TimedOut:
        tried = ", ".join(self._tried) or "nobody"
        within = f"{self._request.deadline.timeout_s * 1e3:g} ms"
        return TimedOut(f"no answer within {within}; asked {tried}")


def _read_refusal(data: bytes) -> RequestError:
    """Read the service's error. Raises `InvalidAnswer` if it breaks the contract."""
    try:
        return RequestError.from_dict(json.loads(data.decode()))
    except (ValueError, RecursionError) as error:
        raise InvalidAnswer(f"an error that is not the contract's: {data[:80]!r}") from error
