"""Settings over a file, or alone and then for this machine only."""

from __future__ import annotations

import math
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from anchorflow_client import ConnectionFailed
from anchorflow_client.zenoh_client import (
    AsyncZenohAnchorClient,
    ZenohAnchorClient,
    ZenohConfigError,
    ZenohSettings,
)
from anchorflow_client.zenoh_client.session import config_of, open_session

ENDPOINT = "tcp/127.0.0.1:7447"


@pytest.mark.parametrize(
    ("given", "mode", "listen"),
    [
        ({}, "peer", [ENDPOINT]),
        ({"mode": "router"}, "router", [ENDPOINT]),
        ({"connect": ("tcp/h:1",)}, "client", []),
        ({"mode": "peer", "connect": ("tcp/h:1",)}, "peer", []),
        ({"connect": ("tcp/h:1",), "listen": ("tcp/h:2",)}, "peer", ["tcp/h:2"]),
    ],
)
def test_without_a_file_nothing_is_open_beyond_this_machine(
    given: dict[str, Any], mode: str, listen: list[str]
) -> None:
    values = ZenohSettings(**given).overrides()

    assert (values["mode"], values["listen/endpoints"]) == (mode, listen)
    assert values["scouting/multicast/enabled"] is False
    assert values["connect/retry"]["period_max_ms"] == 1000
    assert values["transport/unicast/open_timeout"] == 5000


def test_a_file_is_changed_only_where_told(tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text('{mode: "router", listen: {endpoints: ["tcp/[::1]:1"]}}')

    config = config_of(ZenohSettings(config_file=file, connect=("tcp/h:2",)))

    assert config.get_json("mode") == '"router"'
    assert config.get_json("listen/endpoints") == '["tcp/[::1]:1"]'
    assert config.get_json("connect/endpoints") == '["tcp/h:2"]'


def test_what_is_secret_is_not_shown() -> None:
    settings = ZenohSettings(user="robot", password="secret")

    assert "secret" not in repr(settings)
    assert "secret" not in settings.describe()


def test_access_control_is_taken_from_its_own_file(tmp_path: Path) -> None:
    file = tmp_path / "access.json5"
    file.write_text('{mode: "router", access_control: {enabled: true, default_permission: "deny"}}')

    config = config_of(ZenohSettings(access_control_file=file))

    assert '"default_permission":"deny"' in config.get_json("access_control")
    assert config.get_json("mode") == '"peer"'


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"mode": "broker"}, "mode: expected peer, client, router, got 'broker'"),
        ({"user": "robot"}, "user and password: expected both or none"),
        ({"tls_ca": Path("no.pem")}, "tls_ca: no.pem is not a file"),
        ({"config_file": Path("no.json5")}, "config_file: no.json5 is not a file"),
        ({"tls_certificate": Path("a.pem")}, "tls_certificate and tls_private_key"),
        ({"connect": ENDPOINT}, f"connect: expected a tuple of endpoints, got '{ENDPOINT}'"),
        ({"listen": ENDPOINT}, f"listen: expected a tuple of endpoints, got '{ENDPOINT}'"),
    ],
)
def test_settings_that_do_not_go_together_are_refused(given: dict[str, Any], words: str) -> None:
    with pytest.raises(ZenohConfigError, match=words):
        ZenohSettings(**given)


@pytest.mark.parametrize("text", ["{", "{mode: 3}", "{listen: 5}", ""])
def test_a_file_that_zenoh_cannot_read_is_named(tmp_path: Path, text: str) -> None:
    file = tmp_path / "broken.json5"
    file.write_text(text)

    with pytest.raises(ZenohConfigError, match=r"broken\.json5: "):
        config_of(ZenohSettings(config_file=file))


@pytest.mark.parametrize("endpoint", ["tcp/127.0.0.1", "tls/[::1]", "tcp/h:", "udp/h#iface=lo"])
@pytest.mark.parametrize("where", ["connect", "listen"])
def test_an_endpoint_without_a_port_is_named(endpoint: str, where: str) -> None:
    given: dict[str, Any] = {where: (ENDPOINT, endpoint)}
    with pytest.raises(ZenohConfigError) as caught:
        ZenohSettings(**given)
    assert str(caught.value) == f"{where}: expected a port, as in {ENDPOINT}, got {endpoint!r}"
    with pytest.raises(ZenohConfigError, match="connect: expected a port"):
        ZenohAnchorClient(endpoint)


@pytest.mark.parametrize("endpoint", ["tcp/[::1]:0", "unixsock-stream/a.sock", "tcp/h:1#iface=lo"])
def test_an_endpoint_that_has_or_needs_no_port_is_taken(endpoint: str) -> None:
    ZenohSettings(connect=(endpoint,))


@pytest.mark.parametrize("host", ["a..b", "a" * 64])
def test_a_host_that_cannot_be_a_name_is_named(host: str) -> None:
    with pytest.raises(ConnectionFailed, match=f"nobody listens at tcp/{host}:7447: .*label"):
        open_session(ZenohSettings(connect=(f"tcp/{host}:7447",)))


@pytest.mark.parametrize("mode", ["peer", "router"])
def test_a_port_that_another_router_has_is_named(mode: str) -> None:
    """Case V3: a ROS 2 router listens on zenoh's port, too."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(ZenohConfigError) as caught:
            open_session(ZenohSettings(mode=mode, listen=(endpoint,)))

    assert endpoint in str(caught.value)
    assert "another program listens there, such as a ROS 2 router (rmw_zenohd)" in str(caught.value)


def test_an_endpoint_of_no_protocol_or_of_another_machine_is_refused() -> None:
    with pytest.raises(ZenohConfigError, match="connect/endpoints: "):
        config_of(ZenohSettings(connect=("127.0.0.1:7447",)))
    with pytest.raises(ZenohConfigError, match=r"192\.0\.2\.1"):
        open_session(ZenohSettings(listen=("tcp/192.0.2.1:7447",)))


@pytest.mark.parametrize("kind", [ZenohAnchorClient, AsyncZenohAnchorClient])
@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (math.inf, r"expected at most 1e\+06 s, got inf"),
        *((each, f"expected a number above 0, got {each}") for each in (0, -1.0, math.nan)),
    ],
)
def test_a_timeout_out_of_range_is_refused(
    kind: Callable[..., object], seconds: float, words: str
) -> None:
    with pytest.raises(ValueError, match=f"timeout_s: {words}"):
        kind(ENDPOINT, timeout_s=seconds)
