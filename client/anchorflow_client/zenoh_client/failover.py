"""One request, asked of one replica after another until one answers or the time is up."""

from __future__ import annotations

import logging
import queue
import time

import zenoh

from anchorflow_client.codec import Payload
from anchorflow_client.errors import (
    AnchorFlowError,
    ConnectionFailed,
    NotReady,
    Overloaded,
    RequestError,
    TimedOut,
    Unauthorized,
    UnknownModel,
)
from anchorflow_client.keys import replica_anchors_key
from anchorflow_client.zenoh_client.attempt import (
    SETTLE_S,
    Attempt,
    Question,
    answer_of,
    refusal_of,
)
from anchorflow_client.zenoh_client.network import TIMEOUT, Network
from anchorflow_client.zenoh_client.replicas import Choice
from anchorflow_client.zenoh_messages import Load

HEDGE_SHARE = 0.5
"""Share of the time left after which a silent replica is no longer waited for alone."""

logger = logging.getLogger(__name__)


_Outcome = tuple[str, zenoh.Reply | None] | None
"""A replica, and its reply or None at its query's end; None alone: it was taken back."""


class Failover:
    """Asks, and asks somebody else where that helps. Used once, by one thread."""

    def __init__(self, network: Network, question: Question) -> None:
        self._network = network
        self._replicas = network.replicas
        self._question = question
        self._outcomes: queue.SimpleQueue[_Outcome] = queue.SimpleQueue()
        self._open: dict[str, Attempt] = {}
        self._tried: list[str] = []
        self._empty: dict[str, Attempt] = {}
        self._refusal: RequestError | None = None

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
            with self._question.deadline.watched_by(lambda: self._outcomes.put(None)):
                self._ask_another()
                while (answer := self._step()) is None:
                    pass
                return answer
        finally:
            for attempt in list(self._open.values()):
                attempt.cancel()
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
        if outcome is None:  # to look at the deadline again
            return None
        name, reply = outcome
        attempt = self._open.get(name)
        if attempt is None:  # its reply was read already, and this is the end of the query
            return None
        if reply is not None and reply.ok is not None:
            return self._read(attempt, reply.ok)
        self._read_refusal(attempt, None if reply is None else reply.err)
        if all(each.is_late for each in self._open.values()):
            self._ask_another()
        return None

    def _ask_another(self) -> None:
        """Asks the next replica, if there is one. Raises where nothing is left to wait for."""
        if not self._question.deadline.left_s:
            raise self._timed_out()
        while (choice := self._choose()) is None:
            if self._open:
                return
            if not self._replicas.wait_for_word(self._tried, self._question.deadline):
                raise self._verdict()
        share_s = self._question.deadline.left_s * HEDGE_SHARE
        patience_s = max(share_s, 2e-3 * choice.expected_ms)
        name, key = choice.replica, replica_anchors_key(choice.replica, choice.model)
        attempt = Attempt(self._replicas.begin(name), choice.model, key, patience_s)
        self._tried.append(name)
        self._open[name] = attempt
        logger.debug("request %s: asking %s", self._question.request_id, name)
        attempt.send(
            self._network.session, self._question, lambda reply: self._outcomes.put((name, reply))
        )

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
        self._network.hear_anew(self._question.deadline.at_most(SETTLE_S))

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

    def _read(self, attempt: Attempt, sample: zenoh.Sample) -> Payload:
        payload, load = answer_of(sample)
        self._close(attempt, load)
        logger.debug(
            "request %s: %s answered in %.1f ms",
            self._question.request_id,
            attempt.replica.name,
            (time.monotonic() - attempt.sent) * 1e3,
        )
        return payload

    def _read_refusal(self, attempt: Attempt, error: zenoh.ReplyError | None) -> None:
        """Notes why this replica does not answer. Raises what no other would answer better."""
        request_id, name = self._question.request_id, attempt.replica.name
        data = None if error is None else error.payload.to_bytes()
        if data is None or data == TIMEOUT:
            self._close(attempt, None, failed=True)
            logger.warning("request %s: nothing came from %s", request_id, name)
            if data is None:
                self._empty[name] = attempt
            return
        refusal = refusal_of(data)
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
        """Why nobody is left to ask."""
        if self._refusal is not None:
            return self._refusal
        settled = self._question.deadline.at_most(SETTLE_S)
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
        return self._network.why_nobody(self._question.deadline)

    def _timed_out(self) -> TimedOut:
        asked = ", ".join(self._tried) or "nobody"
        within = f"{self._question.deadline.timeout_s * 1e3:g} ms"
        return TimedOut(f"no answer within {within}; asked {asked}")
