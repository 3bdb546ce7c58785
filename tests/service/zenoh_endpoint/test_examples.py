"""The example configurations open as they are, and do what their comments say."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from anchorflow_client import Unauthorized, UnknownModel
from anchorflow_client.zenoh_client import ZenohAnchorClient, ZenohSettings
from anchorflow_client.zenoh_client.session import RETRY, config_of
from anchorflow_service.planning import PlanningService

EXAMPLES = Path(__file__).resolve().parents[3] / "examples" / "zenoh"
CONFIGS = sorted(path.name for path in EXAMPLES.glob("*.json5"))


def example(name: str, **over: Any) -> ZenohSettings:
    """Return an example's settings, with another endpoint."""
    return ZenohSettings(config_file=EXAMPLES / name, **over)


@pytest.mark.parametrize("name", CONFIGS)
def test_nothing_is_reached_beyond_this_machine(name: str) -> None:
    config = config_of(example(name))

    endpoints = [*_list(config, "listen/endpoints"), *_list(config, "connect/endpoints")]
    assert endpoints
    assert all(endpoint.partition("/")[2] == "127.0.0.1:7447" for endpoint in endpoints)
    assert json.loads(config.get_json("scouting/multicast/enabled")) is False


def _list(config: Any, key: str) -> list[str]:
    value = json.loads(config.get_json(key))
    # Zenoh's own default has a list for each mode.
    return [] if isinstance(value, dict) else value


@pytest.mark.parametrize("name", [name for name in CONFIGS if name.startswith("client")])
def test_clients_reconnect_as_soon_as_without_a_file(name: str) -> None:
    tries = json.loads(config_of(example(name)).get_json("connect/retry"))

    assert tries["period_max_ms"] == RETRY["period_max_ms"]


@pytest.mark.parametrize(
    ("service", "robot"),
    [
        ("peer.json5", "client.json5"),
        ("router.json5", None),  # a service may be the router
        ("behind router.json5", "client.json5"),
    ],
)
def test_a_robot_reaches_a_service(
    start_router: Any,
    serve: Any,
    endpoint: str,
    fields: dict[str, Any],
    service: str,
    robot: str | None,
) -> None:
    client = endpoint if robot is None else example(robot, connect=(endpoint,))
    if service.startswith("behind "):
        start_router(EXAMPLES / service.removeprefix("behind "))
        serve(client)
    else:
        serve(example(service, listen=(endpoint,)))

    with ZenohAnchorClient(client) as it:
        assert it.plan(**fields).seed == 1


def test_both_ends_show_a_certificate(
    start_router: Any,
    serve: Any,
    authority: Callable[..., Any],
    tmp_path: Path,
    endpoint: str,
    fields: dict[str, Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ca = authority("certificates")
    ca.sign("router")
    ca.sign("node")
    where = endpoint.replace("tcp/", "tls/")
    monkeypatch.chdir(tmp_path)  # the files name certificates/…
    start_router(EXAMPLES / "router-tls.json5", at=where)
    node = example("client-tls.json5", connect=(where,))
    serve(node)

    with ZenohAnchorClient(node) as client:
        assert client.plan(**fields).seed == 1


def test_each_user_has_its_own_rights(
    start_router: Any,
    serve: Any,
    engine: Any,
    tmp_path: Path,
    endpoint: str,
    fields: dict[str, Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shutil.copy(EXAMPLES / "users.txt", tmp_path)
    monkeypatch.chdir(tmp_path)
    start_router(EXAMPLES / "router-access.json5")

    def user(name: str, password: str) -> ZenohSettings:
        return example("client-password.json5", connect=(endpoint,), user=name, password=password)

    serve(user("service", "replace me"), replica="a")
    with ZenohAnchorClient(example("client-password.json5", connect=(endpoint,))) as robot:
        assert robot.plan(**fields).seed == 1
        assert robot.plan(**fields, model="bows").seed == 1
    with ZenohAnchorClient(user("guest", "guest")) as guest:
        assert guest.live()
        with pytest.raises(Unauthorized, match="a is alive, and nothing comes"):
            guest.plan(**fields)
    # A robot may not act as a replica, whatever it declares.
    traps = type(engine)(replace(engine.card, name="traps"))
    impostor = PlanningService({"traps": traps}, default="traps")
    serve(user("robot", "replace me too"), impostor, replica="impostor")
    with ZenohAnchorClient(user("robot", "replace me too")) as robot:
        assert [card.name for card in robot.models()] == ["lines", "bows"]
        with pytest.raises(UnknownModel):
            robot.plan(**fields, model="traps")
