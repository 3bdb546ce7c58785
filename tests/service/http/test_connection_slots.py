"""Which connections have a slot, and which one is closed for a new one."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, strategies as st

from anchorflow_service.http.connections import (
    RESERVE,
    ConnectionLimits,
    ConnectionSlots,
    source_of,
)


class FakeConnection:
    """Notes that it was closed."""

    def __init__(self) -> None:
        self.has_sent_all = True
        self.is_closed = False

    def abort(self) -> None:
        self.is_closed = True


class Slots(ConnectionSlots):
    """Slots, and fake connections that enter them."""

    def __init__(self, max_connections: int = 3, max_per_address: int = 2) -> None:
        super().__init__(ConnectionLimits(max_connections, max_per_address))

    def open(self, source: str | None = "a", *, busy: bool = False) -> Any:
        """A new connection, and whether it has a slot."""
        connection: Any = FakeConnection()
        connection.has_slot = self.enter(connection, source)
        if busy:
            self.mark_busy(connection)
        return connection


def test_the_connection_that_has_been_idle_longest_is_closed() -> None:
    slots = Slots(max_per_address=3)
    x, y, z = (slots.open() for _ in range(3))
    slots.mark_busy(x)
    slots.mark_idle(x)  # it has been idle only since now

    for closed in (y, z, x):
        assert not closed.is_closed
        assert slots.open().has_slot
        assert closed.is_closed


def test_no_connection_with_a_request_is_closed() -> None:
    slots = Slots(max_per_address=3)
    busy = [slots.open(busy=True) for _ in range(3)]
    reserve = [slots.open("b") for _ in range(RESERVE)]
    for each in reserve[1:]:
        slots.mark_busy(each)

    assert not any(each.has_slot for each in reserve)
    slots.open("b", busy=True)
    assert reserve[0].is_closed  # the only idle one in the reserve
    slots.open("b")
    assert reserve[1].is_closed  # all have a request: the oldest of the reserve
    assert not any(each.is_closed for each in busy)


def test_an_address_with_its_share_closes_its_own_connections() -> None:
    slots = Slots()
    other = slots.open("b")
    x, y = slots.open("a"), slots.open("a")

    assert slots.open("a", busy=True).has_slot
    assert x.is_closed
    slots.mark_busy(y)
    assert not slots.open("a").has_slot  # though `other` has been idle longer
    assert not other.is_closed
    assert slots.open("c").has_slot
    assert other.is_closed


def test_a_connection_that_leaves_frees_its_slot_and_share() -> None:
    slots = Slots(1, 1)
    x = slots.open(busy=True)
    slots.leave(x)
    slots.leave(x)
    slots.mark_idle(x)

    assert slots.open().has_slot
    assert not x.is_closed


def test_without_an_address_there_is_no_share() -> None:
    slots = Slots(3, 1)

    assert [slots.open(None).has_slot for _ in range(3)] == [True] * 3


def test_a_response_that_is_still_being_sent_is_not_cut_off() -> None:
    slots = Slots(2, 2)
    slow, x = slots.open(), slots.open()
    slow.has_sent_all = False

    assert slots.open("b").has_slot
    assert (slow.is_closed, x.is_closed) == (False, True)


@given(
    st.lists(
        st.tuples(
            st.sampled_from(["open", "busy", "idle", "leave"]), st.integers(0, 9), st.booleans()
        )
    )
)
def test_no_bound_is_ever_exceeded(steps: list[tuple[str, int, bool]]) -> None:
    slots = Slots()
    opened: list[tuple[Any, str]] = []
    for action, index, is_a in steps:
        if action == "open":
            source = "a" if is_a else "b"
            opened.append((slots.open(source), source))
        elif opened:
            connection = opened[index % len(opened)][0]
            if connection.is_closed:
                continue
            {"busy": slots.mark_busy, "idle": slots.mark_idle, "leave": slots.leave}[action](
                connection
            )
            connection.is_closed |= action == "leave"
        placed = [source for each, source in opened if each.has_slot and not each.is_closed]
        assert len(placed) <= 3
        assert max(map(placed.count, "ab")) <= 2


@pytest.mark.parametrize(
    ("address", "source"),
    [
        ("192.0.2.7", "192.0.2.7"),
        ("::ffff:192.0.2.7", "192.0.2.7"),
        ("2001:db8::1", "2001:db8::/64"),
        ("2001:db8::ffff:1", "2001:db8::/64"),
        ("2001:db8:0:1::1", "2001:db8:0:1::/64"),
        ("fe80::1%eth0", "fe80::/64"),
        ("testclient", "testclient"),
    ],
)
def test_an_ipv6_network_is_one_source(address: str, source: str) -> None:
    assert source_of(address) == source
