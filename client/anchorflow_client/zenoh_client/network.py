"""A session on the network, and who is alive on it."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import zenoh

from anchorflow_client.errors import (
    AnchorFlowError,
    ConnectionFailed,
    InvalidAnswer,
    TimedOut,
    Unauthorized,
)
from anchorflow_client.keys import ALL_INFO, ALL_REPLICAS, info_key, replica_of
from anchorflow_client.zenoh_client.background import Background
from anchorflow_client.zenoh_client.deadline import Deadline
from anchorflow_client.zenoh_client.replicas import FRESH_S, Replicas
from anchorflow_client.zenoh_messages import ReplicaInfo

DISCOVERY_S = 0.5
"""How long after the connection a service may take to be seen."""
INFO_S = 2.0
"""How long a replica may take to tell of itself."""
TIMEOUT = b"Timeout"
"""What zenoh itself replies when a query takes too long."""

logger = logging.getLogger(__name__)


class Network:
    """Watches the replicas' liveliness tokens, and has each tell its cards and its load.

    Args:
        session: open, and closed with this.
        explaining: finds out why the session has nobody to talk to.
    """

    def __init__(self, session: zenoh.Session, explaining: Background[AnchorFlowError]) -> None:
        self.session = session
        self.replicas = Replicas()
        self._explaining = explaining
        self._seen_by = time.monotonic() + DISCOVERY_S
        self._was_let_in = bool(session.info.transports())
        # A bare callable would get a thread of its own, for which a program that ends waits.
        see = zenoh.handlers.Callback(self._see, indirect=False)
        session.liveliness().declare_subscriber(ALL_REPLICAS, see, history=True)

    def settle(self, deadline: Deadline) -> None:
        """Returns when a replica is known that can be asked, or none is to be expected."""
        self._refresh()
        early_s = max(0.0, self._seen_by - time.monotonic())
        self.replicas.wait_until_known(deadline, somebody_s=early_s)

    def hear_anew(self, deadline: Deadline) -> None:
        """Has every replica tell of itself now: models come and go."""
        self._refresh(fresh_s=0.0)
        self.replicas.wait_until_told(deadline)

    def infos(self, deadline: Deadline) -> list[ReplicaInfo]:
        """What the replicas tell of themselves now; those that say nothing are left out.

        Raises:
            ConnectionFailed: nobody is there.
            Unauthorized: replicas are alive, and none may be asked.
            TimedOut: replicas are alive, and none answers in time.
            InvalidAnswer: what they tell cannot be read.
            Cancelled: the caller gives up.
        """
        self.settle(deadline)
        timeout_s = min(INFO_S, max(deadline.left_s, 1e-3))
        token, told = zenoh.CancellationToken(), []
        with translated(deadline), deadline.watched_by(token.cancel):
            replies = self.session.get(
                ALL_INFO,
                target=zenoh.QueryTarget.ALL,
                timeout=timeout_s,
                cancellation_token=token,
            )
            for reply in replies:
                with suppress(TimedOut, InvalidAnswer):
                    told.append(_info(reply))
        deadline.check()
        if not told:
            raise self.why_nobody(deadline)
        return told

    def why_nobody(self, deadline: Deadline) -> AnchorFlowError:
        """Why there is no replica that can be asked."""
        # Who is late may answer yet; who tells what cannot be read is not denied.
        for kind in (TimedOut, InvalidAnswer, Unauthorized):
            if alike := [why for why in self.replicas.silences() if isinstance(why, kind)]:
                return kind("; ".join(map(str, alike)))
        if quiet := self.replicas.unheard() or self.replicas.alive():
            return TimedOut(f"{', '.join(quiet)} is alive and has not told yet what it serves")
        info = self.session.info
        if info.transports():
            nodes = ", ".join(map(str, (*info.routers_zid(), *info.peers_zid())))
            seen = "no service is alive there that this node may see"
            return ConnectionFailed(f"connected to {nodes}: {seen}")
        try:
            reason = self._explaining.result(deadline)
        except TimedOut:
            return ConnectionFailed("not connected to any zenoh node")
        if self._was_let_in and isinstance(reason, Unauthorized):
            # Who was started again listens for a while before zenoh has mended the connection.
            return ConnectionFailed(f"the connection broke and is not mended yet, or {reason}")
        return reason

    def close(self) -> None:
        """Leave the network."""
        self.session.close()

    def _see(self, sample: zenoh.Sample) -> None:
        """A replica's liveliness token came or went."""
        name = replica_of(str(sample.key_expr))
        if sample.kind == zenoh.SampleKind.PUT:
            logger.info("replica %s is alive", name)
            self._was_let_in = True
            self.replicas.appear(name)
            self._refresh()
        else:
            logger.info("replica %s is gone", name)
            self.replicas.vanish(name)

    def _refresh(self, *, fresh_s: float = FRESH_S) -> None:
        """Has those tell of themselves whose word is old; waits for none of them."""
        for name in self.replicas.to_be_asked(fresh_s=fresh_s):
            self._have_told(name)

    def _have_told(self, name: str) -> None:
        hearing = _Hearing(self.replicas, name)
        handler = zenoh.handlers.Callback(hearing.hear, hearing.end, indirect=False)
        with suppress(zenoh.ZError):  # the session was closed meanwhile
            self.session.get(info_key(name), handler, timeout=INFO_S)


@contextmanager
def translated(deadline: Deadline) -> Iterator[None]:
    """Zenoh's own errors, which a session that was closed raises, as the contract's."""
    try:
        yield
    except zenoh.ZError as error:
        deadline.check()
        raise ConnectionFailed(f"the connection is closed: {error}") from error


class _Hearing:
    """One replica is asked to tell of itself."""

    def __init__(self, replicas: Replicas, name: str) -> None:
        self._replicas = replicas
        self._name = name
        self._has_told = False
        self._why: AnchorFlowError = Unauthorized(
            f"{name} is alive, and nothing comes from its info key: "
            "access control denies it to this node"
        )

    def hear(self, reply: zenoh.Reply) -> None:
        try:
            info = _info(reply)
            if info.replica != self._name:
                raise InvalidAnswer(f"expected what it tells of itself, got {info.replica}'s")
        except (TimedOut, InvalidAnswer) as error:
            self._why = type(error)(f"{self._name} is alive, and its info key: {error}")
        else:
            self._has_told = True
            self._replicas.learn(info)

    def end(self) -> None:
        if not self._has_told:
            self._replicas.hear_nothing(self._name, self._why)


def _info(reply: zenoh.Reply) -> ReplicaInfo:
    """What a reply tells.

    Raises:
        TimedOut: it is zenoh's own, as nothing came in time.
        InvalidAnswer: it cannot be read, which the log tells too.
    """
    if reply.ok is not None:
        try:
            return ReplicaInfo.from_bytes(reply.ok.payload.to_bytes())
        except InvalidAnswer as error:
            logger.warning("%s: %s", reply.ok.key_expr, error)
            raise
    said = b"" if reply.err is None else reply.err.payload.to_bytes()
    if said == TIMEOUT:
        raise TimedOut(f"nothing came within {INFO_S:g} s")
    raise InvalidAnswer(f"expected what a replica tells of itself, got an error: {said[:80]!r}")
