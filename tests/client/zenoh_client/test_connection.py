"""A client connects in the background, once, and its callers may give up at any time."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
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
from anchorflow_client.zenoh_client.network import Background, Connection
from anchorflow_client.zenoh_messages import ReplicaInfo

PATIENCE_S = 20.0
AT_ONCE_S = 4.0
"""Less than zenoh's own timeout."""


@pytest.fixture
def at_once() -> Any:
    """Fail if the test took long."""
    start = time.monotonic()
    yield
    assert time.monotonic() - start < AT_ONCE_S


def calls(client: ZenohAnchorClient, fields: dict[str, Any]) -> dict[str, Callable[..., object]]:
    request = AnchorRequest.from_fields(fields)
    return {"plan": partial(client.plan_request, request), "models": client.models}


@pytest.mark.usefixtures("at_once")
@pytest.mark.parametrize("call", ["plan", "models", "live", "ready"])
@pytest.mark.parametrize("how", ["cancel", "close"])
def test_a_caller_that_gives_up_while_connecting_returns(
    silent: str, fields: dict[str, Any], call: str, how: str
) -> None:
    cancellation = Cancellation()
    with ZenohAnchorClient(silent, timeout_s=PATIENCE_S) as client:
        give_up = client.close if how == "close" else cancellation.cancel
        threading.Timer(0.2, give_up).start()
        if call in ("live", "ready"):
            assert getattr(client, call)(cancellation=cancellation) is False
        else:
            with pytest.raises(Cancelled):
                calls(client, fields)[call](cancellation=cancellation)


@pytest.mark.parametrize("call", ["plan", "models"])
def test_closing_while_no_replica_is_seen_cancels_the_request(
    peer: Any, endpoint: str, fields: dict[str, Any], call: str
) -> None:
    assert peer.asked == []
    with ZenohAnchorClient(endpoint, timeout_s=PATIENCE_S) as client:
        threading.Timer(0.1, client.close).start()
        with pytest.raises(Cancelled):
            calls(client, fields)[call]()


@pytest.mark.parametrize("how", ["cancel", "close"])
def test_a_caller_that_gives_up_while_infos_arrive_returns(
    peer: Any, endpoint: str, card: ModelCard, info: Callable[..., ReplicaInfo], how: str
) -> None:
    """The replica replies to the first query for its info, and not to the second."""
    queries: list[zenoh.Query] = []
    cancellation = Cancellation()
    client = ZenohAnchorClient(endpoint, timeout_s=PATIENCE_S)

    def tell_once(query: zenoh.Query) -> None:
        queries.append(query)
        if len(queries) == 1:
            with query:
                query.reply(query.key_expr, info("a", card).to_bytes())
        else:
            (client.close if how == "close" else cancellation.cancel)()

    peer.play(info("a", card), peer.answer, tell=tell_once)
    with client, pytest.raises(Cancelled):
        client.models(cancellation=cancellation)


@pytest.mark.anyio
@pytest.mark.usefixtures("at_once")
@pytest.mark.parametrize("call", ["plan", "models", "live", "ready"])
async def test_a_task_that_is_cancelled_while_connecting_frees_its_thread(
    silent: str, fields: dict[str, Any], call: str
) -> None:
    async with AsyncZenohAnchorClient(silent, timeout_s=PATIENCE_S, max_threads=1) as client:
        asked = client.plan(**fields) if call == "plan" else getattr(client, call)()
        with pytest.raises(asyncio.TimeoutError):
            await asyncio.wait_for(asked, 0.1)
        with pytest.raises(TimedOut, match="not done within 100 ms"):
            await client.plan(**fields, budget_ms=100)


ENDS_WHILE_IT_CONNECTS = """
silent = socket.create_server(("127.0.0.1", 0))  # closed when Python ends
endpoint = f"tcp/127.0.0.1:{silent.getsockname()[1]}"
file = Path(sys.argv[2]) / "impatient.json5"
file.write_text("{transport: {unicast: {open_timeout: 1500}}}")
settings = ZenohSettings(mode="client", connect=(endpoint,), config_file=file)
with ZenohAnchorClient(settings, timeout_s=0.3) as client:
    assert not client.live()
print("ended")
"""
RAISES_WITH_AN_OPEN_CLIENT = """
client = ZenohAnchorClient(sys.argv[1])
assert client.live()
sys.excepthook = lambda kind, error, _: print(f"{kind.__name__}: {error}")
raise LookupError("of the program")
"""
FORKS = """
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
IMPORTS = """
import os, socket, sys
from pathlib import Path
from anchorflow_client import ConnectionFailed
from anchorflow_client.zenoh_client import ZenohAnchorClient, ZenohSettings
"""


@pytest.fixture
def alive(peer: Any, endpoint: str, card: ModelCard, info: Callable[..., ReplicaInfo]) -> str:
    """The endpoint of a replica that is alive."""
    peer.play(info("a", card), peer.answer)
    return endpoint


@pytest.mark.parametrize(
    ("program", "code", "words", "count"),
    [
        (ENDS_WHILE_IT_CONNECTS, 0, "ended", 1),
        (RAISES_WITH_AN_OPEN_CLIENT, 1, "LookupError: of the program", 1),
        pytest.param(
            *(FORKS, 0, "zenoh does not survive a fork", 2),
            marks=pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork"),
        ),
    ],
    ids=["ends while it connects", "raises", "forks"],
)
def test_a_program_ends_whatever_its_client_does(
    alive: str, tmp_path: Path, program: str, code: int, words: str, count: int
) -> None:
    command = [sys.executable, "-c", IMPORTS + program, alive, str(tmp_path)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)

    assert (ended.returncode, ended.stderr) == (code, "")
    assert ended.stdout.count(words) == count


@pytest.mark.anyio
async def test_an_async_client_that_is_closed_says_so(alive: str, fields: dict[str, Any]) -> None:
    async with AsyncZenohAnchorClient(alive) as client:
        assert await client.live()
    await client.aclose()
    assert not await client.live()
    assert not await client.ready()
    for call in (client.plan(**fields), client.models()):
        with pytest.raises(ConnectionFailed, match="the client is closed"):
            await call


def test_concurrent_callers_get_the_same_network(peer: Any, endpoint: str) -> None:
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


def test_the_next_caller_gets_an_unclaimed_result() -> None:
    opened, calls = threading.Event(), []

    def slow() -> int:
        calls.append(1)
        assert opened.wait(PATIENCE_S)
        return len(calls)

    background = Background(slow, name="slow")
    for _ in range(2):
        with pytest.raises(TimedOut, match="slow: not done within 10 ms"):
            background.result(Deadline(0.01))
    opened.set()

    assert background.result(Deadline(PATIENCE_S)) == 1
    assert background.result(Deadline(PATIENCE_S)) == 2


def test_concurrent_callers_share_one_call_and_may_give_up() -> None:
    opened, calls, cancellation = threading.Event(), [], Cancellation()

    def slow() -> int:
        calls.append(1)
        assert opened.wait(PATIENCE_S)
        return len(calls)

    background = Background(slow, name="slow")
    with ThreadPoolExecutor(5) as executor:
        waiting = [executor.submit(background.result, Deadline(PATIENCE_S)) for _ in range(4)]
        given_up = executor.submit(background.result, Deadline(PATIENCE_S, cancellation))
        with pytest.raises(TimedOut):
            background.result(Deadline(0.05))
        cancellation.cancel()
        with pytest.raises(Cancelled):
            given_up.result()
        assert calls == [1]
        opened.set()
        assert 1 in {each.result(PATIENCE_S) for each in waiting}
