"""Who has a place, and who makes room: by how long they have waited, and by whose they are."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from anchorflow_service.http.places import ConnectionPlaces, source_of


def places(
    most: int = 3,
    per_source: int = 2,
    reserve: int = 2,
    may_close: Callable[[str], bool] = lambda _: True,
) -> ConnectionPlaces[str]:
    return ConnectionPlaces(
        places=most, per_source=per_source, reserve=reserve, may_close=may_close
    )


def test_whoever_has_waited_longest_makes_room() -> None:
    held = places(per_source=3)
    assert [held.enter(name, "a") for name in "xyz"] == [(True, None)] * 3

    held.begin_request("x")
    held.begin_waiting("x")  # from now on, after the others
    held.begin_waiting("y")  # it has waited all along

    assert [held.enter(name, "a") for name in "uvw"] == [(True, "y"), (True, "z"), (True, "x")]


def test_nobody_with_a_request_makes_room() -> None:
    held = places(per_source=3)
    for name in "xyz":
        held.enter(name, "a")
        held.begin_request(name)

    assert [held.enter(name, "b") for name in "uv"] == [(False, None)] * 2
    held.begin_request("v")
    assert held.enter("w", "b") == (False, "u")  # the one in the reserve that waits
    held.begin_request("w")
    assert held.enter("t", "b") == (False, "v")  # all are at work: the oldest of the reserve


def test_a_source_with_its_share_makes_room_among_its_own() -> None:
    held = places()
    held.enter("other", "b")
    held.enter("x", "a")
    held.enter("y", "a")

    assert held.enter("z", "a") == (True, "x")
    held.begin_request("y")
    held.begin_request("z")
    assert held.enter("u", "a") == (False, None)  # though "other" has waited longer
    assert held.enter("v", "c") == (True, "other")


def test_who_leaves_leaves_a_place_and_a_share_behind() -> None:
    held = places(most=1, per_source=1)
    held.enter("x", "a")
    held.begin_request("x")
    held.leave("x")
    held.leave("x")

    assert held.enter("y", "a") == (True, None)


def test_without_a_source_there_is_no_share() -> None:
    held = places(per_source=1)

    assert [held.enter(name, None) for name in "xyz"] == [(True, None)] * 3


def test_an_answer_that_is_not_yet_taken_is_not_cut_off() -> None:
    held = places(most=2, may_close=lambda name: name != "slow")
    held.enter("slow", "a")
    held.enter("x", "a")

    assert held.enter("y", "b") == (True, "x")


@given(
    st.lists(
        st.tuples(
            st.sampled_from(["enter", "request", "wait", "leave"]),
            st.integers(0, 9),
            st.sampled_from("ab"),
        )
    )
)
def test_no_bound_is_ever_passed(steps: list[tuple[str, int, str]]) -> None:
    held: ConnectionPlaces[int] = ConnectionPlaces(
        places=3, per_source=2, reserve=2, may_close=lambda _: True
    )
    inside: dict[int, tuple[bool, str]] = {}
    at_work: set[int] = set()
    for action, who, source in steps:
        if action == "enter" and who not in inside:
            has_place, evicted = held.enter(who, source)
            if evicted is not None:
                was_placed, _ = inside.pop(evicted)
                assert not (was_placed and evicted in at_work)
                at_work.discard(evicted)
            inside[who] = (has_place, source)
        elif action == "request" and who in inside:
            held.begin_request(who)
            at_work.add(who)
        elif action == "wait":
            held.begin_waiting(who)
            at_work.discard(who)
        elif action == "leave":
            held.leave(who)
            inside.pop(who, None)
            at_work.discard(who)
        placed = [source for has_place, source in inside.values() if has_place]
        assert len(placed) <= 3
        assert max(map(placed.count, "ab")) <= 2
        assert len(inside) - len(placed) <= 2


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
