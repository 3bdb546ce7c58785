"""The next replica to query: the one with the shortest expected time."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from anchorflow_client import ModelCard, TimedOut, UnknownModel
from anchorflow_client.cancellation import Deadline
from anchorflow_client.zenoh_client.replicas import Replicas
from anchorflow_client.zenoh_messages import Load, ReplicaInfo

Info = Callable[..., ReplicaInfo]


@pytest.fixture
def replicas(clock: Any, card: ModelCard, info: Info) -> Replicas:
    """Return idle replicas "a" and "b", which serve "lines" in 10 ms."""
    replicas = Replicas(clock=clock)
    for name in "ab":
        replicas.appear(name)
        replicas.learn(info(name, card))
    return replicas


def chosen(replicas: Replicas, model: str | None = None, *tried: str) -> tuple[Any, Any, Any]:
    """Return the choice: replica, model, expected time in ms."""
    return replicas.choose(model, tried) or (None, None, None)


def test_the_idle_one_is_chosen(replicas: Replicas, card: ModelCard, info: Info) -> None:
    first = replicas.begin(chosen(replicas)[0])  # one's own requests count at once
    assert chosen(replicas)[0] != first.name
    replicas.end(first, Load(0, 1, 10.0))
    assert chosen(replicas)[0] == first.name
    replicas.end(replicas.begin("a"), Load(4, 1, 10.0))  # as an answer reports it
    assert chosen(replicas)[0] == "b"

    replicas.learn(info("a", card, in_flight=1))
    assert chosen(replicas)[0] == "b"
    replicas.learn(info("b", card, in_flight=2))
    assert chosen(replicas) == ("a", "lines", 20.0)


def test_one_without_a_mean_is_tried_but_not_flooded(
    replicas: Replicas, card: ModelCard, info: Info
) -> None:
    replicas.appear("c")
    replicas.learn(info("c", card, mean_service_ms=0.0))
    asked = [replicas.begin(chosen(replicas)[0]).name for _ in range(6)]

    assert asked[0] == "c"
    assert sorted(asked) == ["a", "a", "b", "b", "c", "c"]


def test_one_that_failed_comes_last_for_a_while_and_a_tried_or_lost_one_never(
    replicas: Replicas, clock: Any
) -> None:
    replicas.end(replicas.begin("a"), None, failed=True)
    replicas.end(replicas.begin("b"), Load(9, 1, 10.0))
    assert chosen(replicas)[0] == "b"
    assert chosen(replicas, None, "b")[0] == "a"
    assert chosen(replicas, None, "a", "b")[0] is None
    clock.now += 3
    assert chosen(replicas)[0] == "a"

    replicas.vanish("a")
    replicas.end(replicas.begin("a"), None, failed=True)
    assert replicas.alive() == ("b",)
    assert chosen(replicas)[0] == "b"


@pytest.mark.parametrize("doubt", ["not ready", "silent"])
def test_a_doubtful_one_comes_last(
    replicas: Replicas, card: ModelCard, info: Info, doubt: str
) -> None:
    if doubt == "silent":
        replicas.note_silence("a", why := TimedOut("nothing came"))
        assert replicas.silences() == (why,)
    else:
        replicas.learn(info("a", card, ready=False))
    replicas.learn(info("b", card, in_flight=50))

    assert chosen(replicas)[0] == "b"
    assert chosen(replicas, None, "b")[0] == "a"


def test_one_that_reappears_is_not_charged_the_requests_that_it_lost(
    replicas: Replicas, card: ModelCard, info: Info
) -> None:
    lost = [replicas.begin("a") for _ in range(2)]
    replicas.vanish("a")
    replicas.appear("a")
    replicas.learn(info("a", card))
    replicas.begin("a")
    for each in lost:
        replicas.end(each, None)

    assert chosen(replicas, None, "b")[2] == 20.0  # behind the one that is outstanding


def test_only_one_that_serves_the_model_or_its_default_is_chosen(
    replicas: Replicas, card: ModelCard, info: Info
) -> None:
    bows = replace(card, name="bows")
    replicas.learn(info("b", bows, in_flight=9))
    assert chosen(replicas, "bows")[0] == "b"
    assert chosen(replicas, "lines")[0] == "a"
    with pytest.raises(UnknownModel, match=r"\(bows, lines\), got 'nobody'"):
        replicas.choose("nobody")

    replicas.learn(info("a", bows))
    replicas.learn(info("b", bows, card, in_flight=9))
    assert chosen(replicas)[:2] == ("b", "lines")
    replicas.learn(info("b", bows))
    with pytest.raises(UnknownModel, match=r"\(bows\), got the default"):
        replicas.choose(None)

    for name in "ab":
        replicas.learn(info(name))
    for model in (None, "lines"):
        with pytest.raises(UnknownModel, match=r"is served \(none at present\)"):
            replicas.choose(model)
    assert replicas.has_dropped("a", "lines")


def test_one_without_info_may_serve_any_model_by_name_and_has_dropped_none(
    replicas: Replicas,
) -> None:
    replicas.appear("c")
    assert chosen(replicas, "nobody")[0] == "c"
    assert chosen(replicas, None, "a", "b")[0] is None

    replicas.vanish("b")
    assert not any(replicas.has_dropped(name, "lines") for name in "abc")


def test_old_infos_are_queried_again_and_awaited(
    replicas: Replicas, clock: Any, card: ModelCard, info: Info
) -> None:
    assert replicas.to_be_queried() == []
    replicas.wait_for_queries(Deadline(0.0))
    clock.now += 1.5
    assert replicas.to_be_queried() == ["a", "b"]
    assert replicas.to_be_queried() == []
    replicas.note_silence("a", TimedOut("nothing came"))
    threading.Timer(0.05, replicas.learn, [info("b", replace(card, name="bows"))]).start()
    replicas.wait_for_queries(Deadline(20.0))
    assert chosen(replicas, "bows")[0] == "b"

    clock.now += 0.5
    assert replicas.to_be_queried() == []
    assert replicas.to_be_queried(fresh_s=0.0) == ["a", "b"]


def test_threads_see_one_state(replicas: Replicas) -> None:
    def ask() -> None:
        for _ in range(500):
            replicas.end(replicas.begin(chosen(replicas)[0]), None)

    threads = [threading.Thread(target=ask) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()

    assert chosen(replicas)[2] == 10.0  # no request is left outstanding
