"""The client: asks services for anchors over zenoh."""

from __future__ import annotations

import uuid
from collections.abc import Sequence

from anchorflow_client.base_client import BaseClient
from anchorflow_client.cancellation import Cancellation
from anchorflow_client.codec import answer_to
from anchorflow_client.contract import AnchorBatch, AnchorRequest, ModelCard
from anchorflow_client.errors import Cancelled, ConnectionFailed, TimedOut
from anchorflow_client.oip_codec import OipCodec
from anchorflow_client.patience import LONGEST_S, check_times
from anchorflow_client.zenoh_client.attempt import Question
from anchorflow_client.zenoh_client.connection import Connection
from anchorflow_client.zenoh_client.deadline import Deadline
from anchorflow_client.zenoh_client.failover import Failover
from anchorflow_client.zenoh_client.network import Network
from anchorflow_client.zenoh_client.settings import ZenohSettings
from anchorflow_client.zenoh_messages import ReplicaInfo


class ZenohAnchorClient(BaseClient):
    """The replicas of a service on a zenoh network; threads may share it.

        with ZenohAnchorClient("tcp/127.0.0.1:7447") as client:
            anchors = client.plan(
                cost_map=occupancy, resolution=0.1, x_curr=state, x_goal=goal, budget_ms=80
            )

    The replica that is likely the first to answer is asked, by the load that replicas report. Where
    it dies, or is full, another is asked within the same time.

    Errors:
        ConnectionFailed: nobody is there: no router, no service, or TLS fails.
        Unauthorized: the user or password is wrong, or access control denies the key.
        TimedOut: no answer came within `budget_ms`, or `timeout_s` without one; or a service is
            alive and does not answer.
        Cancelled: the request was taken back, or the client was closed meanwhile.
        InvalidAnswer: what came is not the contract's.
        RequestError: the service refuses, in the same words as over HTTP.
    """

    def __init__(
        self,
        where: str | Sequence[str] | ZenohSettings,
        *,
        timeout_s: float = 30.0,
    ) -> None:
        """Opens nothing yet.

        Args:
            where: endpoints to connect to, such as tcp/127.0.0.1:7447, or settings.
            timeout_s: longest wait for an answer, and the budget that the service is told, where
                the request brings none.

        Raises:
            ValueError: `timeout_s` is not above 0, or over 10⁶ s.
        """
        check_times(LONGEST_S, timeout_s=timeout_s)
        self._connection = Connection(_settings(where))
        self._timeout_s = float(timeout_s)
        self._codec = OipCodec()
        self._closing = Cancellation()

    def plan_request(
        self, request: AnchorRequest, *, cancellation: Cancellation | None = None
    ) -> AnchorBatch:
        """Anchors for a request that was built before.

        Args:
            request: its `budget_ms` bounds the whole call, connecting and failover included.
            cancellation: takes the request back, from any thread.
        """
        deadline = self._deadline(cancellation, request.budget_ms)
        question = Question(
            payload=self._codec.encode_request(request),
            content_type=self._codec.content_type,
            request_id=request.request_id or uuid.uuid4().hex,
            model=request.model,
            deadline=deadline,
        )
        payload = Failover(self._settled(deadline), question).run()
        return answer_to(request, self._codec.decode_answer(payload))

    def models(self, *, cancellation: Cancellation | None = None) -> tuple[ModelCard, ...]:
        """The cards of all bundles that are served, the default first."""
        cards: dict[str, ModelCard] = {}
        for info in self._infos(cancellation):
            for card in info.models:
                cards.setdefault(card.name, card)
        return tuple(cards.values())

    def live(self, *, cancellation: Cancellation | None = None) -> bool:
        """Whether a service is there; False where there is none, or no way to it."""
        try:
            network = self._settled(self._deadline(cancellation))
        except (ConnectionFailed, TimedOut, Cancelled):
            return False
        return bool(network.replicas.alive())

    def ready(self, *, cancellation: Cancellation | None = None) -> bool:
        """Whether a replica takes requests now; False while all start or stop, or none is there."""
        try:
            return any(info.ready for info in self._infos(cancellation))
        except (ConnectionFailed, TimedOut, Cancelled):
            return False

    def close(self) -> None:
        """Leave the network; requests that wait for an answer are taken back."""
        self._closing.cancel()
        self._connection.close()

    def _deadline(
        self, cancellation: Cancellation | None, budget_ms: float | None = None
    ) -> Deadline:
        timeout_s = self._timeout_s if budget_ms is None else budget_ms / 1e3
        own = () if cancellation is None else (cancellation,)
        return Deadline(timeout_s, self._closing, *own)

    def _settled(self, deadline: Deadline) -> Network:
        network = self._connection.network(deadline)
        network.settle(deadline)
        return network

    def _infos(self, cancellation: Cancellation | None) -> list[ReplicaInfo]:
        deadline = self._deadline(cancellation)
        return self._connection.network(deadline).infos(deadline)


def _settings(where: str | Sequence[str] | ZenohSettings) -> ZenohSettings:
    if isinstance(where, ZenohSettings):
        return where
    endpoints = (where,) if isinstance(where, str) else tuple(where)
    return ZenohSettings(mode="client", connect=endpoints)
