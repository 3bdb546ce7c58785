"""A zenoh network on this machine, with replicas that a test scripts."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable, Iterator

import pytest
import zenoh

from anchorflow_client import ConnectionFailed, ModelCard, Overloaded
from anchorflow_client.zenoh_client import ZenohSettings
from anchorflow_client.zenoh_client.network import Network
from anchorflow_client.zenoh_client.session import open_session
from anchorflow_client.zenoh_messages import (
    AnswerAttachment,
    Load,
    ReplicaInfo,
    info_key,
    replica_anchors_key,
    replica_key,
)

Reply = Callable[[zenoh.Query], object]


class Peer:
    """A peer with scripted replicas, each of which serves its default."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self.asked: list[str] = []
        """The replicas that received a request, in turn."""
        self.held: list[zenoh.Query] = []
        self._tokens: list[zenoh.LivelinessToken] = []

    def play(self, info: ReplicaInfo, answer: Reply, *, tell: Reply | None = None) -> None:
        """Put a replica on the network.

        Args:
            info: its reply on its info key.
            answer: receives every request.
            tell: handles queries on the info key, in place of a reply with `info`.
        """

        def note(query: zenoh.Query) -> None:
            self.asked.append(info.replica)
            answer(query)

        def tell_all(query: zenoh.Query) -> None:
            with query:
                query.reply(query.key_expr, info.to_bytes())

        key = replica_anchors_key(info.replica, info.default)
        self._session.declare_queryable(info_key(info.replica), tell or tell_all, complete=True)
        self._session.declare_queryable(key, note, complete=True)
        token = self._session.liveliness().declare_token(replica_key(info.replica))
        self._tokens.append(token)

    def hold(self, query: zenoh.Query) -> None:
        """Keep the query open without a reply."""
        self.held.append(query)

    @staticmethod
    def answer(query: zenoh.Query) -> None:
        """Reply with the replica's key."""
        payload = str(query.key_expr).encode()
        said = AnswerAttachment(len(payload), "r1", "any", Load()).to_bytes()
        with query:
            query.reply(query.key_expr, payload, attachment=said)

    @staticmethod
    def refuse(query: zenoh.Query) -> None:
        """Reply that the replica is overloaded."""
        with query:
            query.reply_err(json.dumps(Overloaded("full").to_dict()).encode())


@pytest.fixture
def silent() -> Iterator[str]:
    """Return an endpoint that accepts connections and sends nothing."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        yield f"tcp/127.0.0.1:{listener.getsockname()[1]}"


@pytest.fixture
def peer(endpoint: str) -> Iterator[Peer]:
    """Listen at `endpoint`."""
    with open_session(ZenohSettings(listen=(endpoint,))) as session:
        yield Peer(session)


@pytest.fixture
def network(peer: Peer, endpoint: str) -> Iterator[Network]:
    """Connect a client's network to that peer."""
    assert peer.asked == []
    session = open_session(ZenohSettings(connect=(endpoint,)))
    network = Network(session, lambda _: ConnectionFailed("alone"))
    yield network
    session.close()


def info_of(
    name: str,
    *cards: ModelCard,
    in_flight: int = 0,
    mean_service_ms: float = 10.0,
    ready: bool = True,
) -> ReplicaInfo:
    load = Load(in_flight, 1, mean_service_ms)
    return ReplicaInfo(name, ready=ready, load=load, models=cards, default="lines")


@pytest.fixture
def info() -> Callable[..., ReplicaInfo]:
    """Makes a replica's info; its default is "lines"."""
    return info_of
