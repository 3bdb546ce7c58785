"""The configurations that ship open as they are, and do what their comments say."""

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
    """A file that ships; only where it listens or connects to is another port here."""
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
    # Zenoh's own default, one list for each mode, where a file says nothing.
    return [] if isinstance(value, dict) else value


@pytest.mark.parametrize("name", [name for name in CONFIGS if name.startswith("client")])
def test_who_connects_tries_again_as_soon_as_without_a_file(name: str) -> None:
    tries = json.loads(config_of(example(name)).get_json("connect/retry"))

    assert tries["period_max_ms"] == RETRY["period_max_ms"]


def test_a_robot_reaches_a_peer(serve: Any, endpoint: str, fields: dict[str, Any]) -> None:
    serve(example("peer.json5", listen=(endpoint,)))

    with ZenohAnchorClient(example("client.json5", connect=(endpoint,))) as client:
        assert client.plan(**fields).seed == 1


def test_a_robot_reaches_a_service_behind_a_router(
    start: Any, serve: Any, endpoint: str, fields: dict[str, Any]
) -> None:
    start("router.py", endpoint, EXAMPLES / "router.json5")
    client_settings = example("client.json5", connect=(endpoint,))
    serve(client_settings)

    with ZenohAnchorClient(client_settings) as client:
        assert client.plan(**fields).seed == 1


def test_a_service_may_be_the_router(serve: Any, endpoint: str, fields: dict[str, Any]) -> None:
    serve(example("router.json5", listen=(endpoint,)))

    with ZenohAnchorClient(endpoint) as client:
        assert client.plan(**fields).seed == 1


def test_both_ends_prove_who_they_are(
    start: Any,
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
    start("router.py", where, EXAMPLES / "router-tls.json5", cwd=tmp_path)
    node = example("client-tls.json5", connect=(where,))
    serve(node)

    with ZenohAnchorClient(node) as client:
        assert client.plan(**fields).seed == 1


def test_each_user_may_do_his_own_part(
    start: Any, serve: Any, engine: Any, tmp_path: Path, endpoint: str, fields: dict[str, Any]
) -> None:
    shutil.copy(EXAMPLES / "users.txt", tmp_path)
    start("router.py", endpoint, EXAMPLES / "router-access.json5", cwd=tmp_path)

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
    # A robot may not pass for a replica, whatever it declares.
    traps = type(engine)(replace(engine.card, name="traps"))
    impostor = PlanningService({"traps": traps}, default="traps")
    serve(user("robot", "replace me too"), impostor, replica="impostor")
    with ZenohAnchorClient(user("robot", "replace me too")) as robot:
        assert [card.name for card in robot.models()] == ["lines", "bows"]
        with pytest.raises(UnknownModel):
            robot.plan(**fields, model="traps")
