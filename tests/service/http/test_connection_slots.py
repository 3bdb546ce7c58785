"""Which connections have a slot, and which one is closed for a new one."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, strategies as st

from anchorflow_service.http.connections import (
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
