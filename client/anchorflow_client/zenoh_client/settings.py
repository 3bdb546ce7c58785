"""How to join a zenoh network: by a file, by settings, or by settings over a file."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from anchorflow_client.errors import AnchorFlowError

MODES = ("peer", "client", "router")
DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
"""Where a peer or a router listens that is told nothing else: this machine's own, zenoh's port."""

PORTLESS = re.compile(r"(tcp|tls|udp|quic|ws)/(\[[^]]*\]|[^:?#]*):?([?#].*)?")
"""An endpoint that needs a port and has none."""

OPEN_MS = 5000
"""Longest wait for an endpoint that says nothing; zenoh's own is 10 s. A program cannot end while
its client connects.
"""

RETRY = {"period_init_ms": 250, "period_max_ms": 1000, "period_increase_factor": 2}
"""When a connection that broke is tried again. Zenoh's own tries come up to 4 s apart: a robot
would stand that long before a service that is back.
"""


class ZenohConfigError(AnchorFlowError):
    """Zenoh cannot be configured so; the message names the setting or the file."""


@dataclass(frozen=True, kw_only=True)
class ZenohSettings:
    """What is left out is the file's, and without a file: nothing beyond this machine.

    Zenoh itself would listen on every interface and look for others by multicast.
    """

    config_file: Path | None = None
    """JSON5 as zenoh reads it; what is set here stands above it."""
    mode: str | None = None
    """"peer", "client" or "router"; without a file a client where there is somebody to connect to
    and nowhere to listen, else a peer.
    """
    connect: tuple[str, ...] = ()
    """Endpoints such as tcp/192.168.0.2:7447 or tls/robot.example:7447."""
    listen: tuple[str, ...] = ()
    multicast: bool | None = None
    """Look for others on the local network, and be found."""
    tls_ca: Path | None = None
    """PEM, whose certificates are trusted."""
    tls_certificate: Path | None = None
    """PEM of this node: shown to who connects, and with `mutual_tls` to who is connected to."""
    tls_private_key: Path | None = None
    mutual_tls: bool = False
    """Who connects must show a certificate that `tls_ca` trusts."""
    user: str | None = None
    password: str | None = field(default=None, repr=False)
    users_file: Path | None = None
    """Lines `user:password` of those who may connect to this node."""
    access_control_file: Path | None = None
    """A zenoh config of which `access_control` alone is taken."""

    def __post_init__(self) -> None:
        """Raises `ZenohConfigError`."""
        if self.mode is not None and self.mode not in MODES:
            raise ZenohConfigError(f"mode: expected {', '.join(MODES)}, got {self.mode!r}")
        for name in ("connect", "listen"):
            if isinstance(endpoints := getattr(self, name), str):
                wrong = f"expected a tuple of endpoints, got {endpoints!r}"
                raise ZenohConfigError(f"{name}: {wrong}")
            if lacking := [end for end in endpoints if PORTLESS.fullmatch(str(end))]:
                wrong = f"expected a port, as in {DEFAULT_ENDPOINT}, got {lacking[0]!r}"
                raise ZenohConfigError(f"{name}: {wrong}")
        if (self.user is None) != (self.password is None):
            raise ZenohConfigError("user and password: expected both or none, got one")
        if (self.tls_certificate is None) != (self.tls_private_key is None):
            raise ZenohConfigError(
                "tls_certificate and tls_private_key: expected both or none, got one"
            )
        for name, path in self._files():
            if not path.is_file():
                raise ZenohConfigError(f"{name}: {path} is not a file")

    def overrides(self) -> dict[str, Any]:
        """Zenoh's configuration keys and what they are set to, over the file's."""
        values = {
            "mode": self.mode,
            "connect/endpoints": list(self.connect) or None,
            "listen/endpoints": list(self.listen) or None,
            "scouting/multicast/enabled": self.multicast,
            **self._security(),
        }
        if self.config_file is None:
            values = self._loopback() | {k: v for k, v in values.items() if v is not None}
        return {key: value for key, value in values.items() if value is not None}

    def describe(self) -> str:
        """In a few words, for a log."""
        values = self.overrides()
        file = f"config {self.config_file}" if self.config_file else ""
        ends = [
            f"{verb} {', '.join(values[key])}"
            for verb in ("connect", "listen")
            if values.get(key := f"{verb}/endpoints")
        ]
        return ", ".join(filter(None, [values.get("mode"), file, *ends]))

    def _loopback(self) -> dict[str, Any]:
        """What zenoh would else open to the whole network."""
        is_client = bool(self.connect) and not self.listen
        mode = self.mode or ("client" if is_client else "peer")
        listens = mode != "client" and not self.connect
        return {
            "mode": mode,
            "listen/endpoints": [DEFAULT_ENDPOINT] if listens else [],
            "scouting/multicast/enabled": False,
            "connect/retry": RETRY,
            "transport/unicast/open_timeout": OPEN_MS,
        }

    def _security(self) -> dict[str, Any]:
        tls, auth = "transport/link/tls", "transport/auth/usrpwd"
        certificate, key = _text(self.tls_certificate), _text(self.tls_private_key)
        values = {
            f"{tls}/root_ca_certificate": _text(self.tls_ca),
            f"{tls}/listen_certificate": certificate,
            f"{tls}/listen_private_key": key,
            f"{auth}/user": self.user,
            f"{auth}/password": self.password,
            f"{auth}/dictionary_file": _text(self.users_file),
        }
        if self.mutual_tls:
            values |= {
                f"{tls}/connect_certificate": certificate,
                f"{tls}/connect_private_key": key,
                f"{tls}/enable_mtls": True,
            }
        return values

    def _files(self) -> Iterator[tuple[str, Path]]:
        for name in (
            "config_file",
            "tls_ca",
            "tls_certificate",
            "tls_private_key",
            "users_file",
            "access_control_file",
        ):
            path = getattr(self, name)
            if path is not None:
                yield name, Path(path)


def _text(path: Path | None) -> str | None:
    return None if path is None else str(path)
