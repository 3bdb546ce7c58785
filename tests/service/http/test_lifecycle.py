"""The server's life: what fails at its start, and how it goes."""

from __future__ import annotations

import asyncio
import signal
import socket
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

import pytest
from fastapi import FastAPI

from anchorflow_client import AnchorClient, ConnectionFailed, NotReady
from anchorflow_service.http import create_app
from anchorflow_service.http.lifecycle import AnchorServer, Draining
from anchorflow_service.planning import PlanningService

Start = Callable[[Draining], Any]


@pytest.fixture
def start(app: FastAPI, planning: PlanningService, serve: Callable[[AnchorServer], Any]) -> Start:
    """Starts the application, to go in that way."""
    return lambda draining: serve(AnchorServer(app, planning, draining=draining))


def tell_to_stop(running: Any) -> None:
    """As the signal would: a thread cannot have it."""
    running.server.handle_exit(signal.SIGTERM, None)


def test_readiness_turns_false_before_requests_are_refused(
    start: Start, fields: dict[str, Any]
) -> None:
    running = start(Draining(notice_s=1.0))
    with AnchorClient(running.url, timeout_s=20) as client:
        assert client.ready()
        tell_to_stop(running)

        assert not client.ready()
        assert client.live()
        assert client.plan(**fields).seed == 1

        assert running.has_stopped()
        with pytest.raises(ConnectionFailed):
            client.plan(**fields)


def test_a_second_signal_ends_the_notice(start: Start) -> None:
    running = start(Draining(notice_s=1000))
    tell_to_stop(running)
    assert not running.has_stopped(0.3)

    tell_to_stop(running)
    assert running.has_stopped()


def in_the_background(client: AnchorClient, fields: dict[str, Any]) -> tuple[Any, list[Any]]:
    said: list[Any] = []

    def ask() -> None:
        try:
            said.append(client.plan(**fields))
        except NotReady as error:
            said.append(error)

    thread = threading.Thread(target=ask)
    thread.start()
    return thread, said


def test_what_runs_is_answered_before_it_stops(
    start: Start, gate: Any, fields: dict[str, Any]
) -> None:
    running = start(Draining(drain_s=20))
    with AnchorClient(running.url, timeout_s=20) as client:
        thread, said = in_the_background(client, fields)
        assert gate.reached.wait(20)
        tell_to_stop(running)
        assert not running.has_stopped(0.5)

        gate.opened.set()
        thread.join(20)

    assert said[0].seed == 1
    assert running.has_stopped()


def test_what_outlasts_the_drain_is_told_so(
    start: Start, gate: Any, fields: dict[str, Any]
) -> None:
    running = start(Draining(drain_s=0.3))
    with AnchorClient(running.url, timeout_s=20) as client:
        thread, said = in_the_background(client, fields)
        assert gate.reached.wait(20)
        tell_to_stop(running)
        thread.join(20)

    gate.opened.set()
    assert isinstance(said[0], NotReady)
    assert "stopping" in said[0].message
    assert running.has_stopped()


def test_what_fails_at_the_start_is_raised_as_it_is(planning: PlanningService) -> None:
    @asynccontextmanager
    async def nowhere() -> AsyncIterator[None]:
        await asyncio.sleep(0)
        raise ConnectionFailed("no such place")
        yield

    app = create_app(planning, endpoints=[nowhere()])
    with (
        socket.create_server(("127.0.0.1", 0)) as listener,
        pytest.raises(ConnectionFailed, match="no such place"),
    ):
        AnchorServer(app, planning).run(sockets=[listener])
    assert not planning.is_ready
