"""One request, asked of one replica after another until one answers or the time is up."""

from __future__ import annotations

import json
import logging
import queue
import time
from dataclasses import dataclass

import zenoh

from anchorflow_client.codec import Payload
from anchorflow_client.contract.ranges import BUDGET
from anchorflow_client.errors import (
    AnchorFlowError,
    Cancelled,
    ConnectionFailed,
    InvalidAnswer,
    NotReady,
    Overloaded,
    RequestError,
    TimedOut,
    Unauthorized,
    UnknownModel,
)
from anchorflow_client.keys import replica_anchors_key
from anchorflow_client.zenoh_client.deadline import Deadline
from anchorflow_client.zenoh_client.network import Network, translated
from anchorflow_client.zenoh_client.replicas import Choice
from anchorflow_client.zenoh_messages import AnswerAttachment, Load, RequestAttachment

SETTLE_S = 0.3
"""How long after a query came back empty the replica's death may take to be known."""
HEDGE_SHARE = 0.5
"""Share of the time left after which a silent replica is no longer waited for alone."""
TIMEOUT = b"Timeout"
"""What zenoh itself replies when a query takes too long."""

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Question:
    """What is asked."""

    payload: Payload
    content_type: str
    request_id: str
    model: str | None
    deadline: Deadline


@dataclass
class _Attempt:
    """One query on its way."""

    replica: str
    model: str
    key: str
    sent: float
    patience_s: float
    """How long it is waited for alone."""
    cancellation: zenoh.CancellationToken
    is_late: bool = False


_Outcome = tuple[str, zenoh.Reply | None] | None
"""A replica, and its reply or None at its query's end; None alone: the caller gives up."""


class Asking:
    """Asks, and asks somebody else where that helps. Used once, by one thread."""

    def __init__(self, network: Network, question: Question) -> None:
        self._network = network
        self._replicas = network.replicas
        self._question = question
        self._outcomes: queue.SimpleQueue[_Outcome] = queue.SimpleQueue()
        self._open: dict[str, _Attempt] = {}
        self._tried: list[str] = []
        self._empty: dict[str, _Attempt] = {}
        self._refusal: RequestError | None = None

    def cancel(self) -> None:
        """Take the request back, from any thread."""
        self._outcomes.put(None)

    def run(self) -> Payload:
        """The answer's bytes.

        Raises:
            RequestError: a replica refuses; where it is full or starting or has not the model, all
                of them do.
            Unauthorized: replicas are alive, and what is asked does not reach them.
            ConnectionFailed: none is alive.
            TimedOut: none answered in time.
            Cancelled: it was taken back.
            InvalidAnswer: what came is not the contract's.
        """
        try:
            self._ask_another()
            while (answer := self._step()) is None:
                pass
            return answer
        finally:
            for attempt in list(self._open.values()):
                attempt.cancellation.cancel()
                self._close(attempt, None, failed=attempt.is_late)

    def _step(self) -> Payload | None:
        """Waits for one thing to happen, and does what it calls for."""
        left_s = self._question.deadline.left_s
        if not left_s:
            self._note_late()
            raise self._timed_out()
        try:
            outcome = self._outcomes.get(timeout=min(left_s, self._patience_s()))
        except queue.Empty:
            self._hedge()
            return None
        if outcome is None:
            raise Cancelled("the request was taken back")
        name, reply = outcome
        attempt = self._open.get(name)
        if attempt is None:  # its reply was read already, and this is the end of the query
            return None
        if reply is not None and reply.ok is not None:
            return self._read(attempt, reply.ok)
        self._read_refusal(attempt, None if reply is None else reply.err)
        if not self._open:
            self._ask_another()
        return None

    def _ask_another(self) -> None:
        """Asks the next replica, if there is one. Raises where nothing is left to wait for."""
        left_s = self._question.deadline.left_s
        if not left_s:
            raise self._timed_out()
        choice = self._choose()
        if choice is None:
            if self._open:
                return
            raise self._verdict()
        patience_s = max(left_s * HEDGE_SHARE, 2e-3 * choice.expected_ms)
        key = replica_anchors_key(choice.replica, choice.model)
        cancellation = zenoh.CancellationToken()
        attempt = _Attempt(
            choice.replica, choice.model, key, time.monotonic(), patience_s, cancellation
        )
        self._tried.append(choice.replica)
        self._open[choice.replica] = attempt
        self._replicas.begin(choice.replica)
        self._send(attempt, left_s)

    def _choose(self) -> Choice | None:
        """The next replica. Raises `UnknownModel`."""
        model = self._question.model
        try:
            choice = self._replicas.choose(model, self._tried)
            if choice is None and not self._open and self._forget_who_dropped_the_model():
                choice = self._replicas.choose(model, self._tried)
            return choice
        except UnknownModel:  # by what the replicas told last; it may have been loaded since
            if self._open:  # what was taken before the model went is still answered
                return None
            self._hear_anew()
            return self._replicas.choose(model, self._tried)

    def _forget_who_dropped_the_model(self) -> bool:
        """Whether somebody was asked in vain who serves that model no longer."""
        if self._empty:
            self._hear_anew()
        dropped = [
            name
            for name, attempt in self._empty.items()
            if self._replicas.has_dropped(name, attempt.model)
        ]
        for name in dropped:
            del self._empty[name]
            self._tried.remove(name)
        return bool(dropped)

    def _hear_anew(self) -> None:
        self._network.hear_anew(min(SETTLE_S, self._question.deadline.left_s))

    def _send(self, attempt: _Attempt, left_s: float) -> None:
        question, name = self._question, attempt.replica
        attachment = RequestAttachment(
            header_length=question.payload.header_length,
            request_id=question.request_id,
            # Whatever becomes of this client, the service drops the request by its own clock.
            budget_ms=min(left_s * 1e3, BUDGET.high),
        )

        def hand_over(reply: zenoh.Reply | None = None) -> None:
            self._outcomes.put((name, reply))

        logger.debug("request %s: asking %s", question.request_id, name)
        # On zenoh's own thread, which a put does not hold up.
        handler = zenoh.handlers.Callback(hand_over, hand_over, indirect=False)
        with translated():
            self._network.session.get(
                attempt.key,
                handler,
                payload=question.payload.body,
                encoding=question.content_type,
                attachment=attachment.to_bytes(),
                timeout=left_s + SETTLE_S,
                express=True,
                congestion_control=zenoh.CongestionControl.BLOCK,
                cancellation_token=attempt.cancellation,
            )

    def _patience_s(self) -> float:
        """Time until the latest attempt is no longer waited for alone."""
        if not self._open:
            return 0.0
        latest = max(self._open.values(), key=lambda attempt: attempt.sent)
        return max(0.0, latest.sent + latest.patience_s - time.monotonic())

    def _hedge(self) -> None:
        """The latest attempt is late: ask somebody else too, and take who answers first."""
        if not self._question.deadline.left_s:
            return
        self._note_late()
        late = ", ".join(self._open)
        logger.warning("request %s: %s has not answered yet", self._question.request_id, late)
        self._ask_another()

    def _note_late(self) -> None:
        for attempt in self._open.values():
            attempt.is_late, attempt.patience_s = True, float("inf")

    def _read(self, attempt: _Attempt, sample: zenoh.Sample) -> Payload:
        attachment = None if sample.attachment is None else sample.attachment.to_bytes()
        said = AnswerAttachment.from_bytes(attachment)
        self._close(attempt, said.load)
        logger.debug(
            "request %s: %s answered in %.1f ms",
            self._question.request_id,
            attempt.replica,
            (time.monotonic() - attempt.sent) * 1e3,
        )
        return Payload(sample.payload.to_bytes(), said.header_length)

    def _read_refusal(self, attempt: _Attempt, error: zenoh.ReplyError | None) -> None:
        """Notes why this replica does not answer. Raises what no other would answer better."""
        request_id, name = self._question.request_id, attempt.replica
        data = None if error is None else error.payload.to_bytes()
        if data is None or data == TIMEOUT:
            self._close(attempt, None, failed=True)
            logger.warning("request %s: nothing came from %s", request_id, name)
            if data is None:
                self._empty[name] = attempt
            return
        refusal = _refusal(data)
        is_busy = isinstance(refusal, Overloaded | NotReady)
        self._close(attempt, None, failed=is_busy)
        if not is_busy and not isinstance(refusal, UnknownModel):
            raise refusal
        logger.warning("request %s: %s refused: %s", request_id, name, refusal)
        self._refusal = refusal

    def _close(self, attempt: _Attempt, load: Load | None, *, failed: bool = False) -> None:
        del self._open[attempt.replica]
        self._replicas.end(attempt.replica, load, failed=failed)

    def _verdict(self) -> AnchorFlowError:
        """Why nobody is left to ask."""
        if self._refusal is not None:
            return self._refusal
        wait_s = min(SETTLE_S, self._question.deadline.left_s)
        denied = self._replicas.wait_until_gone(self._empty, wait_s)
        if denied and wait_s < SETTLE_S:  # too early to know whether they died
            return self._timed_out()
        if denied:
            keys = ", ".join(self._empty[name].key for name in denied)
            alive = f"{', '.join(denied)} is alive, and nothing comes back from {keys}"
            return Unauthorized(f"{alive}: access control denies it to this node")
        if self._empty:
            gone = ", ".join(self._empty)
            return ConnectionFailed(f"{gone} went away in mid-answer, and nobody else is there")
        return self._network.why_nobody(self._question.deadline)

    def _timed_out(self) -> TimedOut:
        asked = ", ".join(self._tried) or "nobody"
        within = f"{self._question.deadline.timeout_s * 1e3:g} ms"
        return TimedOut(f"no answer within {within}; asked {asked}")


def _refusal(data: bytes) -> RequestError:
    """The service's own words. Raises `InvalidAnswer` where they are not the contract's."""
    try:
        return RequestError.from_dict(json.loads(data.decode()))
    except (ValueError, RecursionError) as error:
        raise InvalidAnswer(f"an error that is not the contract's: {data[:80]!r}") from error
