"""The connection of a client: made when it is first needed, and again where that failed."""

from __future__ import annotations

import threading

from anchorflow_client.errors import ConnectionFailed
from anchorflow_client.zenoh_client.background import Background
from anchorflow_client.zenoh_client.deadline import Deadline
from anchorflow_client.zenoh_client.network import Network
from anchorflow_client.zenoh_client.session import (
    check_not_forked,
    config_of,
    is_forked,
    open_session,
    why_alone,
)
from anchorflow_client.zenoh_client.settings import ZenohSettings


class Connection:
    """Joins the network in the background. Zenoh itself mends a connection that breaks later."""

    def __init__(self, settings: ZenohSettings) -> None:
        self._settings = settings
        self._lock = threading.Lock()
        self._network: Network | None = None
        self._is_closed = False
        self._joining = Background(self._join, name="connecting")
        self._explaining = Background(lambda: why_alone(config_of(settings)), name="diagnosis")

    def network(self, deadline: Deadline) -> Network:
        """The network.

        Raises:
            TimedOut, Cancelled: it is not joined by then; joining goes on.
            ConnectionFailed, Unauthorized, ZenohConfigError: why it cannot be joined.
        """
        check_not_forked()
        if self._is_closed:
            raise ConnectionFailed("the client is closed")
        return self._network or self._joining.result(deadline)

    def close(self) -> None:
        """Leave the network, at once or as soon as it is joined."""
        with self._lock:
            self._is_closed, network = True, self._network
        if network is not None and not is_forked():
            network.close()

    def _join(self) -> Network:
        if self._network is not None:  # joined since the caller looked
            return self._network
        network = Network(open_session(self._settings), self._explaining)
        with self._lock:
            self._network = network
            is_closed = self._is_closed
        if is_closed:
            network.close()
        return network
