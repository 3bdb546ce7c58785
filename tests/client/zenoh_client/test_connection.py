"""A client connects: in the background, to be given up at any time, and only once."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import zenoh

from anchorflow_client import (
    AnchorRequest,
    Cancellation,
    Cancelled,
    ConnectionFailed,
    ModelCard,
    TimedOut,
)
from anchorflow_client.cancellation import Deadline
from anchorflow_client.zenoh_client import AsyncZenohAnchorClient, ZenohAnchorClient, ZenohSettings
from anchorflow_client.zenoh_client.network import Connection
from anchorflow_client.zenoh_messages import Load, ReplicaInfo

PATIENCE_S = 20.0
AT_ONCE_S = 4.0
"""Below the time after which zenoh gives up."""


@pytest.fixture
def at_once() -> Any:
    """Fails where what is left behind took long."""
    start = time.monotonic()
    yield
    assert time.monotonic() - start < AT_ONCE_S


def calls(client: ZenohAnchorClient, fields: dict[str, Any]) -> dict[str, Callable[..., object]]:
    request = AnchorRequest.from_fields(fields)
    return {"plan": partial(client.plan_request, request), "models": client.models}


@pytest.mark.usefixtures("at_once")
@pytest.mark.parametrize("call", ["plan", "models"])
@pytest.mark.parametrize("how", ["cancel", "close"])
def test_who_gives_up_while_it_connects_is_let_go(
    silent: str, fields: dict[str, Any], call: str, how: str
) -> None:
    cancellation = Cancellation()
    with ZenohAnchorClient(silent, timeout_s=PATIENCE_S) as client:
        give_up = client.close if how == "close" else cancellation.cancel
        threading.Timer(0.2, give_up).start()
        with pytest.raises(Cancelled):
            calls(client, fields)[call](cancellation=cancellation)


@pytest.mark.usefixtures("at_once")
@pytest.mark.parametrize("call", ["live", "ready"])
def test_a_client_that_is_closed_while_it_connects_has_no_way_to_a_service(
    silent: str, call: str
) -> None:
    with ZenohAnchorClient(silent, timeout_s=PATIENCE_S) as client:
        threading.Timer(0.2, client.close).start()
        assert getattr(client, call)() is False


@pytest.mark.parametrize("call", ["plan", "models"])
def test_closing_while_nobody_is_seen_takes_the_request_back(
    peer: Any, endpoint: str, fields: dict[str, Any], call: str
) -> None:
    assert peer.asked == []
    with ZenohAnchorClient(endpoint, timeout_s=PATIENCE_S) as client:
        threading.Timer(0.1, client.close).start()
        with pytest.raises(Cancelled):
            calls(client, fields)[call]()


@pytest.mark.parametrize("how", ["cancel", "close"])
def test_who_gives_up_while_the_cards_are_told_is_let_go(
    peer: Any, endpoint: str, card: ModelCard, how: str
) -> None:
    """It told them when it was seen first, and not a second time."""
    info = ReplicaInfo("a", ready=True, load=Load(), models=(card,), default="lines")
    told: list[zenoh.Query] = []
    cancellation = Cancellation()
    client = ZenohAnchorClient(endpoint, timeout_s=PATIENCE_S)

    def tell_once(query: zenoh.Query) -> None:
        told.append(query)
        if len(told) == 1:
            with query:
                query.reply(query.key_expr, info.to_bytes())
        else:
            (client.close if how == "close" else cancellation.cancel)()

    peer.play(info, peer.answer, tell=tell_once)
    with client, pytest.raises(Cancelled):
        client.models(cancellation=cancellation)


@pytest.mark.parametrize("call", ["plan", "models", "live", "ready"])
def test_a_task_that_is_cancelled_while_it_connects_frees_its_place(
    silent: str, fields: dict[str, Any], call: str
) -> None:
    async def ask() -> float:
        async with AsyncZenohAnchorClient(silent, timeout_s=PATIENCE_S, max_threads=1) as client:
            asked = client.plan(**fields) if call == "plan" else getattr(client, call)()
            with pytest.raises(asyncio.TimeoutError):
                await asyncio.wait_for(asked, 0.1)
            start = time.monotonic()
            with pytest.raises(TimedOut, match="not done within 100 ms"):
                await client.plan(**fields, budget_ms=100)
            return time.monotonic() - start

    assert asyncio.run(ask()) < AT_ONCE_S


ENDS_WHILE_IT_CONNECTS = """
import socket
import sys
from pathlib import Path
from anchorflow_client.zenoh_client import ZenohAnchorClient, ZenohSettings

silent = socket.create_server(("127.0.0.1", 0))  # hangs up where Python ends
endpoint = f"tcp/127.0.0.1:{silent.getsockname()[1]}"
settings = ZenohSettings(mode="client", connect=(endpoint,), config_file=Path(sys.argv[1]))
with ZenohAnchorClient(settings, timeout_s=0.3) as client:
    assert not client.live()
"""


def test_a_program_may_end_while_its_client_connects(tmp_path: Path) -> None:
    file = tmp_path / "impatient.json5"
    file.write_text("{transport: {unicast: {open_timeout: 1500}}}")
    command = [sys.executable, "-c", ENDS_WHILE_IT_CONNECTS, str(file)]

    ended = subprocess.run(command, capture_output=True, text=True, check=False)

    assert (ended.returncode, ended.stderr) == (0, "")


RAISES_WITH_AN_OPEN_CLIENT = """
import sys
from anchorflow_client.zenoh_client import ZenohAnchorClient

client = ZenohAnchorClient(sys.argv[1])
assert client.live()
raise LookupError("of the program")
"""


@pytest.fixture
def alive(peer: Any, endpoint: str, card: ModelCard) -> str:
    """The endpoint at which a replica is alive."""
    info = ReplicaInfo("a", ready=True, load=Load(), models=(card,), default="lines")
    peer.play(info, peer.answer)
    return endpoint


def test_a_program_that_fails_ends_though_its_client_is_open(alive: str) -> None:
    command = [sys.executable, "-c", RAISES_WITH_AN_OPEN_CLIENT, alive]

    ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)

    assert ended.returncode == 1
    assert "LookupError: of the program" in ended.stderr


FORKS = """
import os
import sys
from anchorflow_client import ConnectionFailed
from anchorflow_client.zenoh_client import ZenohAnchorClient

with ZenohAnchorClient(sys.argv[1]) as client:
    assert client.live()
    child = os.fork()
    if child:
        assert os.waitpid(child, 0)[1] == 0
        assert client.ready()
        sys.exit()
    with ZenohAnchorClient(sys.argv[1]) as fresh:
        for each in (client, fresh):
            assert not each.live()
            try:
                each.models()
            except ConnectionFailed as error:
                print(error)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
def test_a_forked_process_is_told_that_it_has_no_session(alive: str) -> None:
    command = [sys.executable, "-c", FORKS, alive]

    ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)

    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.count("zenoh does not survive a fork") == 2


def test_an_async_client_that_is_closed_says_so(alive: str, fields: dict[str, Any]) -> None:
    async def ask() -> None:
        async with AsyncZenohAnchorClient(alive) as client:
            assert await client.live()
        await client.aclose()
        assert not await client.live()
        assert not await client.ready()
        for call in (client.plan(**fields), client.models()):
            with pytest.raises(ConnectionFailed, match="the client is closed"):
                await call

    asyncio.run(ask())


def test_who_looked_before_it_was_joined_gets_the_same_network(peer: Any, endpoint: str) -> None:
    assert peer.asked == []
    connection = Connection(ZenohSettings(connect=(endpoint,)))
    late, joined = threading.Event(), threading.Event()
    join, networks = connection._joining.result, []

    def join_late(deadline: Deadline) -> Any:
        if threading.current_thread() is slow:
            late.set()
            assert joined.wait(PATIENCE_S)
        return join(deadline)

    connection._joining.result = join_late
    slow = threading.Thread(target=lambda: networks.append(connection.network(Deadline(20.0))))
    slow.start()
    assert late.wait(PATIENCE_S)
    networks.append(connection.network(Deadline(PATIENCE_S)))
    joined.set()
    slow.join()
    connection.close()

    assert networks[0] is networks[1]
