"""Open a zenoh session from settings, or raise an error that says why it cannot be opened."""

from __future__ import annotations

import json
import os
import re
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import zenoh

from anchorflow_client.errors import AnchorFlowError, ConnectionFailed
from anchorflow_client.zenoh_client.diagnosis import NOBODY, Approach, explain

MODES = ("peer", "client", "router")
DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
"""Where a peer or a router listens by default: on this machine only, at zenoh's port."""
PORTLESS = re.compile(r"(tcp|tls|udp|quic|ws)/(\[[^]]*\]|[^:?#]*):?([?#].*)?")
"""Matches an endpoint that lacks the port that it needs."""
OPEN_MS = 5000
"""Timeout for an endpoint that does not respond; zenoh's own is 10 s. A program cannot end while
its client connects.
"""
RETRY = {"period_init_ms": 250, "period_max_ms": 1000, "period_increase_factor": 2}
"""When zenoh retries a connection that broke. Its own retries come up to 4 s apart, during which
a robot would stand before a service that is back.
"""
OPEN_RETRY_S = 0.25

_FILES = (
    "config_file",
    "tls_ca",
    "tls_certificate",
    "tls_private_key",
    "users_file",
    "access_control_file",
)
_processes: set[int] = set()
"""Processes that opened a session: this one, or one from which it was forked."""


class ZenohConfigError(AnchorFlowError):
    """Zenoh cannot be configured this way; the message names the setting or the file."""


@dataclass(frozen=True, kw_only=True)
class ZenohSettings:
    """How to join a zenoh network: by a file, by settings, or by settings over a file.

    Without a file the defaults reach nothing beyond this machine; zenoh's own defaults would listen
    on every interface and look for others by multicast.
    """

    config_file: Path | None = None
    """A JSON5 file as zenoh reads it; the settings here override it."""
    mode: str | None = None
    """"peer", "client" or "router"; the default without a file is a client if there are endpoints
    to connect to and none to listen on, else a peer.
    """
    connect: tuple[str, ...] = ()
    """Endpoints such as tcp/192.168.0.2:7447 or tls/robot.example:7447."""
    listen: tuple[str, ...] = ()
    multicast: bool | None = None
    """Look for others on the local network, and be found."""
    tls_ca: Path | None = None
    """PEM file of the certificates to trust."""
    tls_certificate: Path | None = None
    """PEM file that this node shows to others; with `mutual_tls` when it connects, too."""
    tls_private_key: Path | None = None
    mutual_tls: bool = False
    """Nodes that connect must show a certificate that `tls_ca` trusts."""
    user: str | None = None
    password: str | None = field(default=None, repr=False)
    users_file: Path | None = None
    """File of lines `user:password` that may connect to this node."""
    access_control_file: Path | None = None
    """A zenoh config of which only `access_control` is used."""

    def __post_init__(self) -> None:
        """Raise `ZenohConfigError` if the settings are invalid or contradict each other."""
        if self.mode is not None and self.mode not in MODES:
            raise ZenohConfigError(f"mode: expected {', '.join(MODES)}, got {self.mode!r}")
        for name in ("connect", "listen"):
            if isinstance(endpoints := getattr(self, name), str):
                wrong = f"expected a tuple of endpoints, got {endpoints!r}"
                raise ZenohConfigError(f"{name}: {wrong}")
            if lacking := [end for end in endpoints if PORTLESS.fullmatch(str(end))]:
                wrong = f"expected a port, as in {DEFAULT_ENDPOINT}, got {lacking[0]!r}"
                raise ZenohConfigError(f"{name}: {wrong}")
        for one, other in (("user", "password"), ("tls_certificate", "tls_private_key")):
            if (getattr(self, one) is None) != (getattr(self, other) is None):
                raise ZenohConfigError(f"{one} and {other}: expected both or none, got one")
        for name in _FILES:
            path = getattr(self, name)
            if path is not None and not Path(path).is_file():
                raise ZenohConfigError(f"{name}: {path} is not a file")

    def overrides(self) -> dict[str, Any]:
        """Return zenoh's configuration keys with the values that override the file's."""
        values = {
            "mode": self.mode,
            "connect/endpoints": list(self.connect) or None,
            "listen/endpoints": list(self.listen) or None,
            "scouting/multicast/enabled": self.multicast,
            **self._security(),
        }
        values = {key: value for key, value in values.items() if value is not None}
        return values if self.config_file is not None else self._loopback() | values

    def describe(self) -> str:
        """Return a short description for a log."""
        values = self.overrides()
        file = f"config {self.config_file}" if self.config_file else ""
        ends = [
            f"{verb} {', '.join(values[key])}"
            for verb in ("connect", "listen")
            if values.get(key := f"{verb}/endpoints")
        ]
        return ", ".join(filter(None, [values.get("mode"), file, *ends]))

    def _loopback(self) -> dict[str, Any]:
        """Return defaults in place of those with which zenoh opens itself to the network."""
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
        ca, certificate, key, users = (
            None if path is None else str(path)
            for path in (self.tls_ca, self.tls_certificate, self.tls_private_key, self.users_file)
        )
        values = {
            f"{tls}/root_ca_certificate": ca,
            f"{tls}/listen_certificate": certificate,
            f"{tls}/listen_private_key": key,
            f"{auth}/user": self.user,
            f"{auth}/password": self.password,
            f"{auth}/dictionary_file": users,
        }
        if self.mutual_tls:
            values |= {
                f"{tls}/connect_certificate": certificate,
                f"{tls}/connect_private_key": key,
                f"{tls}/enable_mtls": True,
            }
        return values


def open_session(settings: ZenohSettings, *, wait_s: float = 0.0) -> zenoh.Session:
    """Open a session; a client is connected on return, a peer or a router connects when it can.

    Args:
        settings: how to join the network.
        wait_s: how long a client retries while there is no listener at its endpoints.

    Raises:
        ZenohConfigError: zenoh cannot be configured this way, or cannot listen there.
        ConnectionFailed: there is no listener, or TLS fails.
        Unauthorized: the listener rejects this node.
    """
    _processes.add(os.getpid())
    until = time.monotonic() + wait_s
    while True:
        config = config_of(settings)
        try:
            return zenoh.open(config)
        except zenoh.ZError as error:
            reason = _failure(config, error)
            if not str(reason).startswith(NOBODY) or time.monotonic() + OPEN_RETRY_S > until:
                raise reason from error
        time.sleep(OPEN_RETRY_S)


def is_forked() -> bool:
    """Return whether this process was forked after a session was opened.

    Zenoh's threads do not exist in it, and a call into zenoh may never return.
    """
    return bool(_processes) and os.getpid() not in _processes


def check_not_forked() -> None:
    """Raise `ConnectionFailed` if `is_forked`."""
    if is_forked():
        raise ConnectionFailed(
            "zenoh does not survive a fork: expected a process that was started anew, as by "
            "multiprocessing's spawn, or forked before a session was opened"
        )


def config_of(settings: ZenohSettings) -> zenoh.Config:
    """Return zenoh's configuration for the settings. Raises `ZenohConfigError`."""
    config = zenoh.Config() if settings.config_file is None else _read(settings.config_file)
    overrides = settings.overrides()
    if settings.access_control_file is not None:
        rules = _read(settings.access_control_file)
        overrides["access_control"] = _value(rules, "access_control")
    for key, value in overrides.items():
        try:
            config.insert_json5(key, json.dumps(value))
        except zenoh.ZError as error:  # noqa: PERF203 - a dozen keys
            raise ZenohConfigError(f"{key}: {_message(error)}") from error
    return config


def why_alone(config: zenoh.Config) -> AnchorFlowError:
    """Return why a session with this configuration is connected to no other node."""
    tls, endpoints = "transport/link/tls", _value(config, "connect/endpoints")
    if isinstance(endpoints, dict):  # one list for each mode
        endpoints = endpoints.get(_value(config, "mode") or "peer")
    verify_name = _value(config, f"{tls}/verify_name_on_connect")
    return explain(
        Approach(
            endpoints=tuple(map(str, endpoints or ())),
            root_ca=_value(config, f"{tls}/root_ca_certificate"),
            certificate=_value(config, f"{tls}/connect_certificate"),
            private_key=_value(config, f"{tls}/connect_private_key"),
            verify_name=verify_name is not False,
            user=_value(config, "transport/auth/usrpwd/user"),
        )
    )


def _failure(config: zenoh.Config, error: zenoh.ZError) -> AnchorFlowError:
    if "connect" in str(error).lower() or _value(config, "mode") == "client":
        return why_alone(config)
    message = _message(error)
    if "in use" in message:
        message += (
            "; another program listens there, such as a ROS 2 router (rmw_zenohd): connect to it "
            "as a client, or listen on another port"
        )
    return ZenohConfigError(message)


def _read(path: Path) -> zenoh.Config:
    try:
        return zenoh.Config.from_file(path)
    except zenoh.ZError as error:
        raise ZenohConfigError(f"{path}: {_message(error)}") from error


def _value(config: zenoh.Config, key: str) -> Any:
    return json.loads(config.get_json(key))


def _message(error: zenoh.ZError) -> str:
    """Return the message on one line, without the location in zenoh's own sources."""
    return " ".join(re.sub(r"\s+at /\S+\.rs:\d+\.?", "", str(error)).split())
