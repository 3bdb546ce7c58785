"""Join a zenoh network in the background, and watch which replicas are alive on it."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from typing import Generic, TypeVar

import zenoh

from anchorflow_client.cancellation import Deadline
from anchorflow_client.errors import (
    AnchorFlowError,
    ConnectionFailed,
    InvalidAnswer,
    TimedOut,
    Unauthorized,
)
from anchorflow_client.zenoh_client.replicas import FRESH_S, Replicas
from anchorflow_client.zenoh_client.session import (
    ZenohSettings,
    check_not_forked,
    config_of,
    is_forked,
    open_session,
    why_alone,
)
from anchorflow_client.zenoh_messages import (
    ALL_INFO,
    ALL_REPLICAS,
    ReplicaInfo,
    info_key,
    replica_of,
)

DISCOVERY_S = 0.5
"""Time after connecting in which a replica may become visible."""
INFO_S = 2.0
"""Timeout for a replica's info."""
KEPT_S = 5.0
"""How long the outcome of a background call is kept for the next caller."""
TIMEOUT = b"Timeout"
"""Zenoh's own error reply to a query that timed out."""

Result = TypeVar("Result")
logger = logging.getLogger(__name__)


class Background(Generic[Result]):
    """Runs a slow function on a thread, one call at a time, for callers with deadlines."""

    def __init__(self, function: Callable[[], Result], *, name: str) -> None:
        self._function = function
        self._name = name
        self._lock = threading.Lock()
        self._running: Future[Result] | None = None
        self._ended = float("inf")

    def result(self, deadline: Deadline) -> Result:
        """Return the result of the running call, which is started if there is none.

        Raises:
            TimedOut: the call is not done by the deadline, and continues for the next caller.
            Cancelled: the caller was cancelled; the call continues.
            Exception: whatever the function raises.
        """
        running = self._current()
        if not deadline.wait_until_done(running):
            raise TimedOut(f"{self._name}: not done within {deadline.timeout_s * 1e3:.0f} ms")
        with self._lock:
            if self._running is running:
                self._running = None
        return running.result()

    def _current(self) -> Future[Result]:
        with self._lock:
            if self._running is None or time.monotonic() - self._ended > KEPT_S:
                self._running, self._ended = Future(), float("inf")
                # Not a daemon: Python would abort if it ended while a thread is inside zenoh.
                threading.Thread(target=self._run, args=(self._running,), name=self._name).start()
            return self._running

    def _run(self, future: Future[Result]) -> None:
        try:
            result = self._function()
        except Exception as error:  # noqa: BLE001 - raised again by `result`
            self._ended = time.monotonic()
            future.set_exception(error)
        else:
            self._ended = time.monotonic()
            future.set_result(result)


class Connection:
    """Joins the network for the first caller. Zenoh itself reconnects after a later failure."""

    def __init__(self, settings: ZenohSettings) -> None:
        self._settings = settings
        self._lock = threading.Lock()
        self._network: Network | None = None
        self._is_closed = False
        self._joining = Background(self._join, name="connecting")
        self._explaining = Background(lambda: why_alone(config_of(settings)), name="diagnosis")

    def network(self, deadline: Deadline) -> Network:
        """Return the network. Raises why it is not joined by the deadline; joining continues."""
        check_not_forked()
        if self._is_closed:
            raise ConnectionFailed("the client is closed")
        return self._network or self._joining.result(deadline)

    def close(self) -> None:
        """Leave the network, at once or as soon as it is joined."""
        with self._lock:
            self._is_closed, network = True, self._network
        if network is not None and not is_forked():
            network.session.close()

    def _join(self) -> Network:
        if self._network is not None:  # an earlier call joined it meanwhile
            return self._network
        network = Network(open_session(self._settings), self._explaining.result)
        with self._lock:
            self._network = network
            is_closed = self._is_closed
        if is_closed:
            network.session.close()
        return network


class Network:
    """Watches the replicas' liveliness tokens, and queries each for its cards and its load.

    Args:
        session: an open session.
        explain: returns why the session is connected to no other node.
    """

    def __init__(
        self, session: zenoh.Session, explain: Callable[[Deadline], AnchorFlowError]
    ) -> None:
        self.session = session
        self.replicas = Replicas()
        self._explain = explain
        self._visible_by = time.monotonic() + DISCOVERY_S
        self._was_connected = bool(session.info.transports())
        # A bare callable would get a thread of its own, for which a program that ends waits.
        on_token = zenoh.handlers.Callback(self._on_token, indirect=False)
        session.liveliness().declare_subscriber(ALL_REPLICAS, on_token, history=True)

    def settle(self, deadline: Deadline) -> None:
        """Wait until a replica can be queried, or none is expected to appear."""
        self._refresh()
        appear_s = max(0.0, self._visible_by - time.monotonic())
        self.replicas.wait_until_known(deadline, appear_s=appear_s)

    def query_again(self, deadline: Deadline) -> None:
        """Query every replica for its info now, because models may have been loaded or unloaded."""
        self._refresh(fresh_s=0.0)
        self.replicas.wait_for_queries(deadline)

    def infos(self, deadline: Deadline) -> list[ReplicaInfo]:
        """Return the current info of all replicas that answer.

        Raises:
            ConnectionFailed: no replica is alive.
            Unauthorized: replicas are alive, and access control denies all of them.
            TimedOut: replicas are alive, and none answers in time.
            InvalidAnswer: no replica's info can be read.
            Cancelled: the caller was cancelled.
        """
        self.settle(deadline)
        timeout_s = min(INFO_S, max(deadline.left_s, 1e-3))
        token, infos = zenoh.CancellationToken(), []
        with translated(deadline), deadline.watched_by(token.cancel):
            replies = self.session.get(
                ALL_INFO,
                target=zenoh.QueryTarget.ALL,
                timeout=timeout_s,
                cancellation_token=token,
            )
            for reply in replies:
                with suppress(TimedOut, InvalidAnswer):
                    infos.append(_read_info(reply))
        deadline.check()
        if not infos:
            raise self.why_nobody(deadline)
        return infos

    def why_nobody(self, deadline: Deadline) -> AnchorFlowError:
        """Return why there is no replica to query."""
        # A late replica may still answer, and one with unreadable info is not denied.
        for kind in (TimedOut, InvalidAnswer, Unauthorized):
            if alike := [why for why in self.replicas.silences() if isinstance(why, kind)]:
                return kind("; ".join(map(str, alike)))
        if quiet := self.replicas.unknown() or self.replicas.alive():
            return TimedOut(f"{', '.join(quiet)} is alive and has not told yet what it serves")
        info = self.session.info
        if info.transports():
            nodes = ", ".join(map(str, (*info.routers_zid(), *info.peers_zid())))
            seen = "no service is alive there that this node may see"
            return ConnectionFailed(f"connected to {nodes}: {seen}")
        try:
            reason = self._explain(deadline)
        except TimedOut:
            return ConnectionFailed("not connected to any zenoh node")
        if self._was_connected and isinstance(reason, Unauthorized):
            # A restarted node listens for a while before zenoh has reconnected.
            return ConnectionFailed(f"the connection broke and is not mended yet, or {reason}")
        return reason

    def _on_token(self, sample: zenoh.Sample) -> None:
        """Handle a replica's liveliness token that appeared or vanished."""
        name = replica_of(str(sample.key_expr))
        if sample.kind == zenoh.SampleKind.PUT:
            logger.info("replica %s is alive", name)
            self._was_connected = True
            self.replicas.appear(name)
            self._refresh()
        else:
            logger.info("replica %s is gone", name)
            self.replicas.vanish(name)

    def _refresh(self, *, fresh_s: float = FRESH_S) -> None:
        """Query the replicas whose info is old, without waiting for the replies."""
        for name in self.replicas.to_be_queried(fresh_s=fresh_s):
            query = _InfoQuery(self.replicas, name)
            handler = zenoh.handlers.Callback(query.on_reply, query.on_end, indirect=False)
            with suppress(zenoh.ZError):  # the session was closed meanwhile
                self.session.get(info_key(name), handler, timeout=INFO_S)


@contextmanager
def translated(deadline: Deadline) -> Iterator[None]:
    """Translate zenoh's error for a closed session into the contract's."""
    try:
        yield
    except zenoh.ZError as error:
        deadline.check()
        raise ConnectionFailed(f"the connection is closed: {error}") from error


class _InfoQuery:
    """A pending query for one replica's info."""

    def __init__(self, replicas: Replicas, name: str) -> None:
        self._replicas = replicas
        self._name = name
        self._has_info = False
        self._why: AnchorFlowError = Unauthorized(
            f"{name} is alive, and nothing comes from its info key: "
            "access control denies it to this node"
        )

    def on_reply(self, reply: zenoh.Reply) -> None:
        try:
            info = _read_info(reply)
            if info.replica != self._name:
                raise InvalidAnswer(f"expected what it tells of itself, got {info.replica}'s")
        except (TimedOut, InvalidAnswer) as error:
            self._why = type(error)(f"{self._name} is alive, and its info key: {error}")
        else:
            self._has_info = True
            self._replicas.learn(info)

    def on_end(self) -> None:
        if not self._has_info:
            self._replicas.note_silence(self._name, self._why)


def _read_info(reply: zenoh.Reply) -> ReplicaInfo:
    """Read a reply. Raises `TimedOut`, or `InvalidAnswer`, which is logged too."""
    if reply.ok is not None:
        try:
            return ReplicaInfo.from_bytes(reply.ok.payload.to_bytes())
        except InvalidAnswer as error:
            logger.warning("%s: %s", reply.ok.key_expr, error)
            raise
    data = b"" if reply.err is None else reply.err.payload.to_bytes()
    if data == TIMEOUT:
        raise TimedOut(f"nothing came within {INFO_S:g} s")
    raise InvalidAnswer(f"expected what a replica tells of itself, got an error: {data[:80]!r}")
