"""A wrong certificate, a wrong password and a denied key are refused, and the error says which."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from anchorflow_client import ConnectionFailed, Unauthorized
from anchorflow_client.zenoh_client import ZenohAnchorClient, ZenohSettings
from anchorflow_service.zenoh_endpoint import ZenohEndpoint

USERS = {"service": "one", "robot": "two", "guest": "three"}


@pytest.fixture
def tls(authority: Callable[..., Any], serve: Any, endpoint: str) -> ZenohSettings:
    """Serve over TLS, and return the settings of a client that trusts it."""
    ca = authority()
    certificate, key = ca.sign("service")
    where = endpoint.replace("tcp/", "tls/")
    serve(ZenohSettings(listen=(where,), tls_certificate=certificate, tls_private_key=key))
    return ZenohSettings(mode="client", connect=(where,), tls_ca=ca.certificate)


def refusal(settings: ZenohSettings, fields: dict[str, Any]) -> Exception:
    with ZenohAnchorClient(settings, timeout_s=20) as client:
        with pytest.raises((ConnectionFailed, Unauthorized)) as caught:
            client.plan(**fields)
        return caught.value


def test_tls_needs_a_trusted_certificate(
    tls: ZenohSettings, authority: Callable[..., Any], fields: dict[str, Any]
) -> None:
    with ZenohAnchorClient(tls) as client:
        assert client.plan(**fields).seed == 1

    error = refusal(replace(tls, tls_ca=authority("others").certificate), fields)
    assert isinstance(error, ConnectionFailed)
    assert "TLS: its certificate is refused" in str(error)
    assert tls.connect[0] in str(error)

    plain = tls.connect[0].replace("tls/", "tcp/")
    error = refusal(ZenohSettings(mode="client", connect=(plain,)), fields)
    assert isinstance(error, ConnectionFailed)
    assert "it speaks TLS; expected an endpoint tls/" in str(error)


def test_a_certificate_of_another_host_is_refused(
    authority: Callable[..., Any], serve: Any, endpoint: str, fields: dict[str, Any]
) -> None:
    ca, where = authority(), endpoint.replace("tcp/", "tls/")
    certificate, key = ca.sign("service", host="elsewhere.example")
    serve(ZenohSettings(listen=(where,), tls_certificate=certificate, tls_private_key=key))

    error = refusal(ZenohSettings(mode="client", connect=(where,), tls_ca=ca.certificate), fields)

    assert "its certificate is refused: IP address mismatch" in str(error)


def test_mutual_tls_wants_a_certificate(
    authority: Callable[..., Any], serve: Any, endpoint: str, fields: dict[str, Any]
) -> None:
    ca, others, where = authority(), authority("others"), endpoint.replace("tcp/", "tls/")
    certificate, key = ca.sign("service")
    serve(
        ZenohSettings(
            listen=(where,),
            tls_ca=ca.certificate,
            tls_certificate=certificate,
            tls_private_key=key,
            mutual_tls=True,
        )
    )
    without = ZenohSettings(mode="client", connect=(where,), tls_ca=ca.certificate)

    def showing(signed: tuple[Path, Path]) -> ZenohSettings:
        shown = {"tls_certificate": signed[0], "tls_private_key": signed[1]}
        return replace(without, mutual_tls=True, **shown)

    with ZenohAnchorClient(showing(ca.sign("robot"))) as client:
        assert client.plan(**fields).seed == 1
    assert "certificate required" in str(refusal(without, fields))
    assert "TLS: " in str(refusal(showing(others.sign("mallory")), fields))


@pytest.fixture
def users(tmp_path: Path) -> Path:
    file = tmp_path / "users.txt"
    file.write_text("".join(f"{user}:{password}\n" for user, password in USERS.items()))
    return file


def test_a_wrong_password_is_refused(
    serve: Any, users: Path, endpoint: str, fields: dict[str, Any]
) -> None:
    serve(ZenohSettings(listen=(endpoint,), users_file=users))
    robot = ZenohSettings(mode="client", connect=(endpoint,), user="robot", password="two")

    with ZenohAnchorClient(robot) as client:
        assert client.plan(**fields).seed == 1
    for wrong in (replace(robot, password="three"), replace(robot, user="mallory")):
        error = refusal(wrong, fields)
        assert isinstance(error, Unauthorized)
        assert f"the user '{wrong.user}' or its password is wrong" in str(error)
        assert "three" not in str(error)
    error = refusal(replace(robot, user=None, password=None), fields)
    assert "it wants a user and a password" in str(error)
    # A peer's session opens without any connection, and continues to try.
    error = refusal(replace(robot, mode="peer", password="no"), fields)
    assert isinstance(error, Unauthorized)
    assert "'robot' or its password is wrong" in str(error)


def test_a_node_that_was_connected_before_is_not_called_unauthorized(
    start_replica: Any, endpoint: str, fields: dict[str, Any], until: Any
) -> None:
    """A restarted service listens before zenoh has reconnected."""
    service = start_replica("a", 0.0, "listen")
    port = int(endpoint.rpartition(":")[2])
    with ZenohAnchorClient(endpoint, timeout_s=20) as client:
        client.plan(**fields)
        service.kill()
        with socket.create_server(("127.0.0.1", port)):  # and says nothing yet
            until(lambda: not client.live())
            with pytest.raises(ConnectionFailed, match="the connection broke and is not mended"):
                client.plan(**fields)


def rules(*denied: str) -> dict[str, Any]:
    """Return access control rules by which guests may not query the keys."""
    deny = {
        "id": "denied",
        "permission": "deny",
        "flows": ["ingress"],
        "messages": ["query"],
        "key_exprs": list(denied),
    }
    return {
        "enabled": True,
        "default_permission": "allow",
        "rules": [deny],
        "subjects": [{"id": "guests", "usernames": ["guest"]}],
        "policies": [{"rules": ["denied"], "subjects": ["guests"]}],
    }


@pytest.fixture
def guarded(
    start_router: Any, serve: Any, users: Path, endpoint: str, tmp_path: Path
) -> Callable[..., Callable[[str], ZenohSettings]]:
    """Serve behind a router that denies keys to guests, and return users' settings."""

    def build(*denied: str) -> Callable[[str], ZenohSettings]:
        config = {
            "transport": {"auth": {"usrpwd": {"dictionary_file": str(users)}}},
            "access_control": rules(*denied),
        }
        file = tmp_path / "router.json5"
        file.write_text(json.dumps(config))
        start_router(file)

        def settings(user: str) -> ZenohSettings:
            return ZenohSettings(
                mode="client", connect=(endpoint,), user=user, password=USERS[user]
            )

        assert isinstance(serve(settings("service"), replica="a"), ZenohEndpoint)
        return settings

    return build


def test_a_denied_key_is_refused_and_the_others_are_not(
    guarded: Callable[..., Any], fields: dict[str, Any]
) -> None:
    settings = guarded("anchorflow/v1/replica/*/anchors/bows")

    with ZenohAnchorClient(settings("guest")) as guest:
        assert guest.plan(**fields).model.name == "lines"
        with pytest.raises(Unauthorized, match="access control denies it") as caught:
            guest.plan(**fields, model="bows")
        assert "nothing comes back from anchorflow/v1/replica/a/anchors/bows" in str(caught.value)
        assert guest.ready()
    with ZenohAnchorClient(settings("robot")) as robot:
        assert robot.plan(**fields, model="bows").model.name == "bows"
