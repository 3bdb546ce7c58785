"""Who is alive, how busy, and who is asked next. Knows nothing of zenoh."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

from anchorflow_client.contract import ModelCard
from anchorflow_client.errors import AnchorFlowError, UnknownModel
from anchorflow_client.zenoh_client.deadline import Deadline
from anchorflow_client.zenoh_messages import Load, ReplicaInfo

SHUNNED_S = 2.0
"""How long a replica that failed to answer is asked last."""
FRESH_S = 1.0
"""How long what a replica told of itself is taken for true."""


@dataclass
class Replica:
    """A replica that is alive."""

    name: str
    models: tuple[ModelCard, ...] | None = None
    """None: it has not told yet, or may not."""
    default: str | None = None
    """Answers where no model is named; served at present or not."""
    silence: AnchorFlowError | None = None
    """Why nothing came that can be read, where it was asked to tell."""
    is_ready: bool = True
    """False: it starts or stops; it may still answer, and others had better be asked."""
    load: Load = field(default_factory=Load)
    told_at: float = -float("inf")
    is_being_asked: bool = False
    outstanding: int = 0
    """Requests of this client that it has not answered yet."""
    shunned_until: float = -float("inf")

    @property
    def is_known(self) -> bool:
        return self.models is not None or self.silence is not None


class Choice(NamedTuple):
    """Whom to ask, for which model, and when to expect the answer."""

    replica: str
    model: str
    expected_ms: float


class Replicas:
    """The replicas that are alive; threads share it."""

    def __init__(self, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._changed = threading.Condition()
        self._alive: dict[str, Replica] = {}

    def appear(self, name: str) -> None:
        """Its liveliness token is there."""
        with self._changed:
            self._alive.setdefault(name, Replica(name))
            self._changed.notify_all()

    def vanish(self, name: str) -> None:
        """Its liveliness token is gone."""
        with self._changed:
            self._alive.pop(name, None)
            self._changed.notify_all()

    def learn(self, info: ReplicaInfo) -> None:
        """It told of itself."""
        with self._changed:
            if replica := self._alive.get(info.replica):
                replica.models, replica.default = info.models, info.default
                replica.is_ready = info.ready
                replica.silence, replica.is_being_asked = None, False
                replica.load, replica.told_at = info.load, self._clock()
                self._changed.notify_all()

    def hear_nothing(self, name: str, why: AnchorFlowError) -> None:
        """It was asked to tell of itself, and nothing came that can be read."""
        with self._changed:
            if replica := self._alive.get(name):
                replica.silence, replica.is_being_asked = why, False
                replica.told_at = self._clock()
                self._changed.notify_all()

    def to_be_asked(self, *, fresh_s: float = FRESH_S) -> list[str]:
        """Those whose word is older than that; they count as being asked from now on."""
        now = self._clock()
        with self._changed:
            stale = [
                replica
                for replica in self._alive.values()
                if not replica.is_being_asked and now - replica.told_at > fresh_s
            ]
            for replica in stale:
                replica.is_being_asked = True
            return [replica.name for replica in stale]

    def begin(self, name: str) -> Replica:
        """A request is on its way to it. Who comes back under that name is another replica."""
        with self._changed:
            replica = self._alive.get(name) or Replica(name)
            replica.outstanding += 1
            return replica

    def end(self, replica: Replica, load: Load | None, *, failed: bool = False) -> None:
        """That request is over: answered, with the load that came along, or not at all."""
        with self._changed:
            replica.outstanding -= 1
            if load is not None:
                replica.load = load
            if failed:
                replica.shunned_until = self._clock() + SHUNNED_S

    def choose(self, model: str | None, tried: Collection[str] = ()) -> Choice | None:
        """The replica that likely answers first, of those not tried; None where there is none.

        Raises:
            UnknownModel: every replica told what it serves, and none serves the model; for None,
                none serves its default.
        """
        with self._changed:
            self._check_model(model)
            open_to = [
                (replica, name)
                for replica in self._alive.values()
                if replica.name not in tried and (name := _served_as(replica, model))
            ]
            if not open_to:
                return None
            # Who has not answered yet is taken to be as fast as the fastest, and tried first.
            means = (replica.load.mean_service_ms for replica in self._alive.values())
            unknown_ms = min(filter(None, means), default=1.0)
            replica, name = min(open_to, key=lambda pair: self._rank(pair[0], unknown_ms))
            expected_ms = replica.load.expected_ms(replica.outstanding)
            return Choice(replica.name, name, expected_ms)

    def has_dropped(self, name: str, model: str) -> bool:
        """Whether it is alive and tells that it does not serve the model."""
        with self._changed:
            replica = self._alive.get(name)
            return replica is not None and _served_as(replica, model) is None

    def alive(self) -> tuple[str, ...]:
        """Their names."""
        with self._changed:
            return tuple(self._alive)

    def unheard(self, tried: Collection[str] = ()) -> tuple[str, ...]:
        """The names of those not tried that have not told of themselves yet, and still may."""
        with self._changed:
            return tuple(
                name
                for name, replica in self._alive.items()
                if not replica.is_known and name not in tried
            )

    def silences(self) -> tuple[AnchorFlowError, ...]:
        """Why nothing came from those that were asked to tell of themselves in vain."""
        with self._changed:
            return tuple(each.silence for each in self._alive.values() if each.silence is not None)

    def wait_until_known(self, deadline: Deadline, *, somebody_s: float) -> None:
        """Until one has told of itself. Raises `Cancelled`.

        Args:
            deadline: longest wait, as long as somebody is alive who has not told yet.
            somebody_s: longest wait for somebody to be alive at all.
        """

        def one_has_told() -> bool:
            return any(replica.models for replica in self._alive.values())

        with self._changed:
            if one_has_told():  # as a rule
                deadline.check()
                return
        if not deadline.at_most(somebody_s).wait_for(self._changed, one_has_told):
            deadline.wait_for(self._changed, lambda: one_has_told() or not self.unheard())

    def wait_until_told(self, deadline: Deadline) -> None:
        """Until nobody is being asked to tell of himself any more. Raises `Cancelled`."""
        deadline.wait_for(
            self._changed,
            lambda: not any(replica.is_being_asked for replica in self._alive.values()),
        )

    def wait_for_word(self, tried: Collection[str], deadline: Deadline) -> bool:
        """Whether more becomes known of those unheard by then. Raises `Cancelled`."""
        unheard = self.unheard(tried)
        return bool(unheard) and deadline.wait_for(
            self._changed, lambda: self.unheard(tried) != unheard
        )

    def wait_until_gone(self, names: Iterable[str], deadline: Deadline) -> list[str]:
        """Waits for the names to vanish; gives those still alive then. Raises `Cancelled`."""
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
        told = [replica.models for replica in replicas if replica.models is not None]
        if not told or len(told) < len(replicas):
            return
        if any(_served_as(replica, model) for replica in replicas):
            return
        names = ", ".join(sorted({card.name for models in told for card in models}))
        which = "the default" if model is None else repr(model)
        wrong = f"expected a model that is served ({names or 'none at present'}), got {which}"
        raise UnknownModel(wrong, "model")


def _served_as(replica: Replica, model: str | None) -> str | None:
    """The model's name where the replica serves it, or may; its default for None."""
    if replica.models is None:
        return model
    name = replica.default if model is None else model
    return name if any(card.name == name for card in replica.models) else None
