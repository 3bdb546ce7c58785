"""The places that connections hold, and which of them makes room when there is none left.

A connection waits while it has no request: its head has not come, or its last answer is out. It
loses little by being closed, so the one that has waited longest makes room. A connection in a place
is never closed for another once its request has come.
"""

from __future__ import annotations

import ipaddress
from collections import Counter
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Holder = TypeVar("Holder", bound=Hashable)

IPV6_NETWORK_BITS = 64
"""A machine may call from any address of such a network, so all of them count as one."""


class ConnectionPlaces(Generic[Holder]):
    """Places for connections, and a reserve for those that find none.

    A source that holds its share makes room among its own connections. In the reserve even one
    with a request makes room, where none waits: the next one must be heard too.

    Args:
        places: connections at a time.
        per_source: of those, for one source.
        reserve: connections beyond the places, at least 1.
        may_close: whether one that waits has all of its last answer.
    """

    def __init__(
        self, *, places: int, per_source: int, reserve: int, may_close: Callable[[Holder], bool]
    ) -> None:
        self._places = places
        self._per_source = per_source
        self._most_in_reserve = reserve
        self._may_close = may_close
        # In the order in which they came, or began to wait.
        self._sources: dict[Holder, str | None] = {}
        self._reserve: dict[Holder, None] = {}
        self._waiting: dict[Holder, None] = {}
        self._held: Counter[str | None] = Counter()
        """Places by source."""

    def enter(self, holder: Holder, source: str | None) -> tuple[bool, Holder | None]:
        """A connection begins, and waits.

        source: what its address counts as (`source_of`); None: it has none, and no share

        Returns whether it has a place, otherwise it stands in the reserve; and the one to be closed
        in its favour, if any, which holds nothing any more.
        """
        has_place, evicted = self._admission(source)
        if evicted is not None:
            self.leave(evicted)
        if has_place:
            self._sources[holder] = source
            self._held[source] += 1
        else:
            self._reserve[holder] = None
        self._waiting[holder] = None
        return has_place, evicted

    def begin_request(self, holder: Holder) -> None:
        """The head of a request has come."""
        self._waiting.pop(holder, None)

    def begin_waiting(self, holder: Holder) -> None:
        """Its answer is out; one that waits already does so since the same moment as before."""
        if holder in self._sources or holder in self._reserve:
            self._waiting.setdefault(holder)

    def leave(self, holder: Holder) -> None:
        """It is closed; no harm where it has left before."""
        self._waiting.pop(holder, None)
        self._reserve.pop(holder, None)
        if holder in self._sources:
            source = self._sources.pop(holder)
            self._held[source] -= 1
            if not self._held[source]:
                del self._held[source]  # or it would remember every address that ever called

    def _admission(self, source: str | None) -> tuple[bool, Holder | None]:
        if source is not None and self._held[source] >= self._per_source:
            evicted = self._longest_waiting(lambda each: self._sources.get(each) == source)
        elif len(self._sources) >= self._places:
            evicted = self._longest_waiting(lambda each: each in self._sources)
        else:
            return True, None
        if evicted is not None:
            return True, evicted
        if len(self._reserve) < self._most_in_reserve:
            return False, None
        evicted = self._longest_waiting(lambda each: each in self._reserve)
        return False, next(iter(self._reserve)) if evicted is None else evicted

    def _longest_waiting(self, among: Callable[[Holder], bool]) -> Holder | None:
        return next((each for each in self._waiting if among(each) and self._may_close(each)), None)


def source_of(address: str) -> str:
    """What an address counts as: itself, and in IPv6 its network."""
    try:
        ip = ipaddress.ip_address(address)
    except ValueError:
        return address
    if ip.version == 4:
        return str(ip)
    if ip.ipv4_mapped is not None:
        return str(ip.ipv4_mapped)
    return str(ipaddress.ip_network((int(ip), IPV6_NETWORK_BITS), strict=False))
