"""How the service stops: not ready, then no port, then no requests."""

from __future__ import annotations

import signal
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from anchorflow_client import AnchorClient, ConnectionFailed, NotReady
from anchorflow_service.http import create_app
from anchorflow_service.http.lifecycle import Draining, GracefulExit
from anchorflow_service.planning import PlanningService

Start = Callable[[Draining], Any]


@pytest.fixture
def start(planning: PlanningService, serve: Callable[..., Any]) -> Start:
    """Starts the application, to stop in that way."""

    def run(draining: Draining) -> Any:
        graceful = GracefulExit(planning, draining)
        running = serve(create_app(planning, endpoints=[graceful]), draining=draining)
        graceful.exit_handlers[signal.SIGTERM] = running.server.handle_exit
        running.graceful = graceful
        return running

    return run


def tell_to_stop(running: Any) -> None:
    """As the signal would, which a thread cannot receive."""
    running.graceful.handle(signal.SIGTERM)


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


def test_what_runs_is_answered_before_it_stops(
    start: Start, gate: Any, fields: dict[str, Any], background: ThreadPoolExecutor
) -> None:
    running = start(Draining(drain_s=20))
    with AnchorClient(running.url, timeout_s=20) as client:
        asked = background.submit(lambda: client.plan(**fields))
        assert gate.reached.wait(20)
        tell_to_stop(running)
        assert not running.has_stopped(0.5)

        gate.opened.set()
        assert asked.result(20).seed == 1
    assert running.has_stopped()


def test_what_outlasts_the_drain_is_told_so(
    start: Start, gate: Any, fields: dict[str, Any], background: ThreadPoolExecutor
) -> None:
    running = start(Draining(drain_s=0.3))
    with AnchorClient(running.url, timeout_s=20) as client:
        asked = background.submit(lambda: client.plan(**fields))
        assert gate.reached.wait(20)
        tell_to_stop(running)
        with pytest.raises(NotReady, match="stopping"):
            asked.result(20)

    gate.opened.set()
    assert running.has_stopped()
