"""Settings become a session, or an error that says why not."""

from __future__ import annotations

import json
import os
import re
import time
from pathlib import Path
from typing import Any

import zenoh

from anchorflow_client.errors import AnchorFlowError, ConnectionFailed
from anchorflow_client.zenoh_client.diagnosis import NOBODY, Approach, explain
from anchorflow_client.zenoh_client.settings import ZenohConfigError, ZenohSettings

RETRY_S = 0.25

_processes: set[int] = set()
"""Where a session was opened: this process, or one from which it was forked."""


def open_session(settings: ZenohSettings, *, wait_s: float = 0.0) -> zenoh.Session:
    """A session on the network.

    A client is connected when this returns; a peer or a router connects when it can.

    Args:
        settings: how to join.
        wait_s: how long a client tries again while nobody listens where it connects to.

    Raises:
        ZenohConfigError: zenoh cannot be configured so, or cannot listen there.
        ConnectionFailed: nobody listens there, or TLS fails.
        Unauthorized: who listens does not let this node in.
    """
    _processes.add(os.getpid())
    until = time.monotonic() + wait_s
    while True:
        config = config_of(settings)
        try:
            return zenoh.open(config)
        except zenoh.ZError as error:
            reason = _failure(config, error)
            if not str(reason).startswith(NOBODY) or time.monotonic() + RETRY_S > until:
                raise reason from error
        time.sleep(RETRY_S)


def is_forked() -> bool:
    """Whether this process was forked after a session was opened: zenoh's threads are not in it,
    and what is asked of it there may never return.
    """
    return bool(_processes) and os.getpid() not in _processes


def check_not_forked() -> None:
    """Raises `ConnectionFailed` where `is_forked`."""
    if is_forked():
        raise ConnectionFailed(
            "zenoh does not survive a fork: expected a process that was started anew, as by "
            "multiprocessing's spawn, or forked before a session was opened"
        )


def config_of(settings: ZenohSettings) -> zenoh.Config:
    """Zenoh's own form of the settings. Raises `ZenohConfigError`."""
    config = zenoh.Config() if settings.config_file is None else _read(settings.config_file)
    overrides = settings.overrides()
    if settings.access_control_file is not None:
        rules = _read(settings.access_control_file)
        overrides["access_control"] = _value(rules, "access_control")
    for key, value in overrides.items():
        _set(config, key, value)
    return config


def why_alone(config: zenoh.Config) -> AnchorFlowError:
    """Why a session has nobody to talk to."""
    return explain(_approach(config))


def _failure(config: zenoh.Config, error: zenoh.ZError) -> AnchorFlowError:
    if "connect" in str(error).lower() or _value(config, "mode") == "client":
        return why_alone(config)
    return ZenohConfigError(_words(error))


def _approach(config: zenoh.Config) -> Approach:
    tls, endpoints = "transport/link/tls", _value(config, "connect/endpoints")
    if isinstance(endpoints, dict):  # one list for each mode
        endpoints = endpoints.get(_value(config, "mode") or "peer")
    verify_name = _value(config, f"{tls}/verify_name_on_connect")
    return Approach(
        endpoints=tuple(map(str, endpoints or ())),
        root_ca=_value(config, f"{tls}/root_ca_certificate"),
        certificate=_value(config, f"{tls}/connect_certificate"),
        private_key=_value(config, f"{tls}/connect_private_key"),
        verify_name=verify_name is not False,
        user=_value(config, "transport/auth/usrpwd/user"),
    )


def _read(path: Path) -> zenoh.Config:
    try:
        return zenoh.Config.from_file(path)
    except zenoh.ZError as error:
        raise ZenohConfigError(f"{path}: {_words(error)}") from error


def _set(config: zenoh.Config, key: str, value: Any) -> None:
    try:
        config.insert_json5(key, json.dumps(value))
    except zenoh.ZError as error:
        raise ZenohConfigError(f"{key}: {_words(error)}") from error


def _value(config: zenoh.Config, key: str) -> Any:
    return json.loads(config.get_json(key))


def _words(error: zenoh.ZError) -> str:
    """On one line, without the place in zenoh's own sources."""
    return " ".join(re.sub(r"\s+at /\S+\.rs:\d+\.?", "", str(error)).split())
