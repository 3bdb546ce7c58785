"""The replicas that one request is sent to, with scripted replicas."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import pytest
import zenoh
from staged_planner import made_batch

from anchorflow_client import (
    Cancellation,
    Cancelled,
    InvalidAnswer,
    ModelCard,
    OipCodec,
    Payload,
    TimedOut,
    Unauthorized,
)
from anchorflow_client.cancellation import Deadline
from anchorflow_client.zenoh_client import ZenohAnchorClient
from anchorflow_client.zenoh_client.failover import EncodedRequest, Failover
from anchorflow_client.zenoh_client.network import Network
from anchorflow_client.zenoh_messages import AnswerAttachment, Load, ReplicaInfo

PATIENCE_S = 20.0
Info = Callable[..., ReplicaInfo]


def ask(network: Network, deadline: Deadline) -> bytes:
    """Return the answer's bytes of the default model."""
    question = EncodedRequest(Payload(b"", 0), "application/octet-stream", "r1", None, deadline)
    return Failover(network, question).run().body


@pytest.mark.parametrize("refusal", ["refuse", "hang up"])
def test_a_refusal_of_the_second_replica_leads_to_the_third(
    peer: Any, network: Network, card: ModelCard, info: Info, until: Any, refusal: str
) -> None:
    refuse = peer.refuse if refusal == "refuse" else zenoh.Query.drop
    for milliseconds, (name, answer) in enumerate(
        {"a": peer.hold, "b": refuse, "c": peer.answer}.items(), start=1
    ):
        peer.play(info(name, card, mean_service_ms=milliseconds), answer)
    until(lambda: len(network.replicas.alive()) == 3 and not network.replicas.unknown())

    assert ask(network, Deadline(2.0)) == b"anchorflow/v1/replica/c/anchors/lines"
    assert peer.asked == ["a", "b", "c"]


def test_replicas_that_hang_are_asked_in_turn_within_the_budget(
    peer: Any, network: Network, card: ModelCard, info: Info, until: Any
) -> None:
    for milliseconds, name in enumerate("ab", start=1):
        peer.play(info(name, card, mean_service_ms=milliseconds), peer.hold)
    until(lambda: len(network.replicas.alive()) == 2 and not network.replicas.unknown())

    with pytest.raises(TimedOut, match="within 2000 ms; asked a, b"):
        ask(network, Deadline(2.0))
    assert peer.asked == ["a", "b"]


def test_a_pending_info_is_awaited_before_the_default_is_given_up(
    peer: Any, network: Network, card: ModelCard, info: Info, until: Any
) -> None:
    opened = threading.Event()
    late = info("b", card)

    def tell_late(query: zenoh.Query) -> None:
        with query:
            assert opened.wait(PATIENCE_S)
            query.reply(query.key_expr, late.to_bytes())

    peer.play(info("a", replace(card, name="bows")), peer.refuse)
    peer.play(late, peer.answer, tell=tell_late)
    until(lambda: len(network.replicas.alive()) == 2 and network.replicas.unknown() == ("b",))
    with pytest.raises(TimedOut, match=r"^b is alive and has not told yet what it serves"):
        ask(network, Deadline(0.2))
    with ThreadPoolExecutor(1) as executor:
        asked = executor.submit(ask, network, Deadline(PATIENCE_S))
        opened.set()
        assert asked.result() == b"anchorflow/v1/replica/b/anchors/lines"


def tell_rubbish(query: zenoh.Query) -> None:
    with query:
        query.reply(query.key_expr, b"rubbish")


def tell_of_another(query: zenoh.Query) -> None:
    another = ReplicaInfo("b", ready=True, load=Load(), models=(), default="lines")
    with query:
        query.reply(query.key_expr, another.to_bytes())


def refuse_to_tell(query: zenoh.Query) -> None:
    with query:
        query.reply_err(b"no")


@pytest.mark.parametrize(
    ("tell", "kind", "words"),
    [
        (None, TimedOut, "a is alive, and its info key: nothing came within 2 s"),
        (
            zenoh.Query.drop,
            Unauthorized,
            "nothing comes from its info key: access control",
        ),
        (tell_rubbish, InvalidAnswer, "its info key: not what a replica tells of itself"),
        (tell_of_another, InvalidAnswer, "expected what it tells of itself, got b's"),
        (refuse_to_tell, InvalidAnswer, "got an error: b'no'"),
    ],
)
def test_why_a_replicas_info_is_unknown(
    peer: Any,
    network: Network,
    info: Info,
    until: Any,
    tell: Any,
    kind: type[Exception],
    words: str,
) -> None:
    peer.play(info("a"), peer.answer, tell=tell or peer.hold)
    until(network.replicas.silences)

    with pytest.raises(kind, match=words):
        ask(network, Deadline(PATIENCE_S))
    assert isinstance(network.why_nobody(Deadline(PATIENCE_S)), kind)


def test_a_client_of_a_replica_that_hangs_is_not_ready(
    peer: Any, endpoint: str, info: Info
) -> None:
    peer.play(info("a"), peer.answer, tell=peer.hold)

    with ZenohAnchorClient(endpoint, timeout_s=PATIENCE_S) as client:
        assert client.live()
        assert not client.ready()


def test_a_cancelled_request_is_not_sent(
    peer: Any, network: Network, card: ModelCard, info: Info, until: Any
) -> None:
    peer.play(info("a", card), peer.answer)
    until(lambda: network.replicas.alive() and not network.replicas.unknown())
    cancellation = Cancellation()
    cancellation.cancel()

    with pytest.raises(Cancelled):
        ask(network, Deadline(PATIENCE_S, cancellation))
    assert ask(network, Deadline(PATIENCE_S)) == b"anchorflow/v1/replica/a/anchors/lines"
    assert peer.asked == ["a"]


def test_the_answer_to_another_request_is_refused(
    peer: Any, endpoint: str, card: ModelCard, info: Info, fields: dict[str, Any]
) -> None:
    sent = OipCodec().encode_answer(made_batch(request_id="r1"))

    def answer(query: zenoh.Query) -> None:
        said = AnswerAttachment(sent.header_length, "r1", "a", Load())
        with query:
            query.reply(query.key_expr, sent.body, attachment=said.to_bytes())

    peer.play(info("a", card), answer)
    with ZenohAnchorClient(endpoint, timeout_s=PATIENCE_S) as client:
        assert client.plan(**fields, request_id="r1").request_id == "r1"
        assert client.plan(**fields).request_id == "r1"
        with pytest.raises(InvalidAnswer, match="expected the answer to r2, got that to r1"):
            client.plan(**fields, request_id="r2")
