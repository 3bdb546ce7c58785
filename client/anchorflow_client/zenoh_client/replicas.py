"""The replicas that are alive, how busy they are, and which one to query next. Does no I/O."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

from anchorflow_client.cancellation import Deadline
from anchorflow_client.contract import ModelCard
from anchorflow_client.errors import AnchorFlowError, UnknownModel
from anchorflow_client.zenoh_messages import Load, ReplicaInfo

SHUNNED_S = 2.0
"""How long a replica that failed to answer is chosen last."""
FRESH_S = 1.0
"""How long a replica's info stays valid."""


@dataclass
class Replica:
    """A replica that is alive."""

    name: str
    models: tuple[ModelCard, ...] | None = None
    """None until its info has arrived."""
    default: str | None = None
    """The model for requests that name none; it may be unloaded at present."""
    silence: AnchorFlowError | None = None
    """Why its info could not be read, if it was queried in vain."""
    is_ready: bool = True
    """False while it starts or stops; it may still answer, but others are preferred."""
    load: Load = field(default_factory=Load)
    info_at: float = -float("inf")
    is_queried: bool = False
    """Whether a query for its info is pending."""
    outstanding: int = 0
    """Requests of this client that it has not answered yet."""
    shunned_until: float = -float("inf")


class Choice(NamedTuple):
    """The replica to query, the model, and the expected time of the answer."""

    replica: str
    model: str
    expected_ms: float


class Replicas:
    """The replicas that are alive; threads may share it."""

    def __init__(self, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._changed = threading.Condition()
        self._alive: dict[str, Replica] = {}

    def appear(self, name: str) -> None:
        """Add a replica, whose liveliness token has appeared."""
        with self._changed:
            self._alive.setdefault(name, Replica(name))
            self._changed.notify_all()

    def vanish(self, name: str) -> None:
        """Remove a replica, whose liveliness token has gone."""
        with self._changed:
            self._alive.pop(name, None)
            self._changed.notify_all()

    def learn(self, info: ReplicaInfo) -> None:
        """Store a replica's info."""
        with self._changed:
            if replica := self._alive.get(info.replica):
                replica.models, replica.default = info.models, info.default
                replica.is_ready, replica.load = info.ready, info.load
                self._note_info(replica, None)

    def note_silence(self, name: str, why: AnchorFlowError) -> None:
        """Store why a replica's info could not be read."""
        with self._changed:
            if replica := self._alive.get(name):
                self._note_info(replica, why)

    def _note_info(self, replica: Replica, silence: AnchorFlowError | None) -> None:
        replica.silence, replica.is_queried = silence, False
        replica.info_at = self._clock()
        self._changed.notify_all()

    def to_be_queried(self, *, fresh_s: float = FRESH_S) -> list[str]:
        """Return the replicas whose info is older, and mark their queries as pending."""
        now = self._clock()
        with self._changed:
            stale = [
                replica
                for replica in self._alive.values()
                if not replica.is_queried and now - replica.info_at > fresh_s
            ]
            for replica in stale:
                replica.is_queried = True
            return [replica.name for replica in stale]

    def begin(self, name: str) -> Replica:
        """Count a request to a replica. One that reappears under the name is another replica."""
        with self._changed:
            replica = self._alive.get(name) or Replica(name)
            replica.outstanding += 1
            return replica

    def end(self, replica: Replica, load: Load | None, *, failed: bool = False) -> None:
        """Count the end of a request, and store the load that came with its answer."""
        with self._changed:
            replica.outstanding -= 1
            if load is not None:
                replica.load = load
            if failed:
                replica.shunned_until = self._clock() + SHUNNED_S

    def choose(self, model: str | None, tried: Collection[str] = ()) -> Choice | None:
        """Return the untried replica with the shortest expected time; None if there is none.

        Raises `UnknownModel` once every replica is known and none serves the model, or a default.
        """
        with self._changed:
            self._check_model(model)
            candidates = [
                (replica, name)
                for replica in self._alive.values()
                if replica.name not in tried and (name := _served_as(replica, model))
            ]
            if not candidates:
                return None
            # A replica without a mean is assumed to be as fast as the fastest, and tried first.
            means = (replica.load.mean_service_ms for replica in self._alive.values())
            unknown_ms = min(filter(None, means), default=1.0)
            replica, name = min(candidates, key=lambda pair: self._rank(pair[0], unknown_ms))
            expected_ms = replica.load.expected_ms(replica.outstanding)
            return Choice(replica.name, name, expected_ms)

    def has_dropped(self, name: str, model: str) -> bool:
        """Return whether a replica is alive and its info lacks the model."""
        with self._changed:
            replica = self._alive.get(name)
            return replica is not None and _served_as(replica, model) is None

    def alive(self) -> tuple[str, ...]:
        """Return the names of all replicas."""
        with self._changed:
            return tuple(self._alive)

    def unknown(self, tried: Collection[str] = ()) -> tuple[str, ...]:
        """Return the names of the untried replicas whose info may still arrive."""
        with self._changed:
            return tuple(
                name
                for name, replica in self._alive.items()
                if replica.models is None and replica.silence is None and name not in tried
            )

    def silences(self) -> tuple[AnchorFlowError, ...]:
        """Return why the info of replicas could not be read."""
        with self._changed:
            return tuple(each.silence for each in self._alive.values() if each.silence is not None)

    def wait_until_known(self, deadline: Deadline, *, appear_s: float) -> None:
        """Wait for the info of one replica. Raises `Cancelled`.

        Args:
            deadline: longest wait while a replica is alive whose info may arrive.
            appear_s: longest wait for a replica to appear.
        """

        def one_is_known() -> bool:
            return any(replica.models for replica in self._alive.values())

        with self._changed:
            if one_is_known():  # the usual case
                deadline.check()
                return
        if not deadline.at_most(appear_s).wait_for(self._changed, one_is_known):
            deadline.wait_for(self._changed, lambda: one_is_known() or not self.unknown())

    def wait_for_queries(self, deadline: Deadline) -> None:
        """Wait until no query for info is pending. Raises `Cancelled`."""
        deadline.wait_for(
            self._changed,
            lambda: not any(replica.is_queried for replica in self._alive.values()),
        )

    def wait_for_change(self, tried: Collection[str], deadline: Deadline) -> bool:
        """Wait until `unknown` changes, and return whether it did. Raises `Cancelled`."""
        unknown = self.unknown(tried)
        return bool(unknown) and deadline.wait_for(
            self._changed, lambda: self.unknown(tried) != unknown
        )

    def wait_until_gone(self, names: Iterable[str], deadline: Deadline) -> list[str]:
        """Wait for replicas to vanish, and return those still alive. Raises `Cancelled`."""
        wanted = set(names)
        deadline.wait_for(self._changed, lambda: not wanted & self._alive.keys())
        with self._changed:
            return sorted(wanted & self._alive.keys())

    def _rank(self, replica: Replica, unknown_ms: float) -> tuple[int, float, float]:
        doubts = (
            replica.shunned_until > self._clock(),
            replica.silence is not None,
            not replica.is_ready,
        )
        load = replica.load
        expected_ms = load.expected_ms(replica.outstanding, unknown_ms=unknown_ms)
        return sum(doubts), expected_ms, load.mean_service_ms

    def _check_model(self, model: str | None) -> None:
        replicas = self._alive.values()
        known = [replica.models for replica in replicas if replica.models is not None]
        if not known or len(known) < len(replicas):
            return
        if any(_served_as(replica, model) for replica in replicas):
            return
        names = ", ".join(sorted({card.name for models in known for card in models}))
        which = "the default" if model is None else repr(model)
        wrong = f"expected a model that is served ({names or 'none at present'}), got {which}"
        raise UnknownModel(wrong, "model")


def _served_as(replica: Replica, model: str | None) -> str | None:
    """Return the model's name if the replica serves it, or may; its default for None."""
    if replica.models is None:
        return model
    name = replica.default if model is None else model
    return name if any(card.name == name for card in replica.models) else None
