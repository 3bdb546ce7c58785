"""Replicas that die under load: the client queries another in the same time.

Replicas that hang or are overloaded are scripted in `tests/client/zenoh_client/test_failover.py`.
"""

from __future__ import annotations

import logging
import os
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import pytest

from anchorflow_benchmarks.programs import Program
from anchorflow_client import AnchorBatch, AnchorRequest, ConnectionFailed
from anchorflow_client.zenoh_client import ZenohAnchorClient

SECONDS = float(os.environ.get("ANCHORFLOW_FAILOVER_SECONDS", "4"))
"""Duration of the run with a kill and a return."""
HZ, KILL_AT, BACK_AT = 20, 0.3, 0.5  # shares of the run
Start = Callable[..., Program]
CLIENT_LOG = "anchorflow_client.zenoh_client.failover"


def told(records: list[logging.LogRecord], words: str) -> Counter[str]:
    """Count the lines of the client's log with these words, by the replica that they name."""
    lines = [record for record in records if record.name == CLIENT_LOG and words in record.msg]
    return Counter(str(line.args[1]) for line in lines if isinstance(line.args, tuple))


@pytest.fixture
def two(start_router: Start, start_replica: Start) -> dict[str, Program]:
    """Replicas "a" and "b" behind a router, with 40 ms for an answer."""
    start_router()
    return {name: start_replica(name, 0.04) for name in "ab"}


def test_no_request_is_lost_while_a_replica_is_killed_and_comes_back(
    two: dict[str, Program],
    endpoint: str,
    fields: dict[str, Any],
    until: Any,
    caplog: pytest.LogCaptureFixture,
) -> None:
    request = AnchorRequest.from_fields(fields)
    caplog.set_level(logging.DEBUG, CLIENT_LOG)
    with (
        ZenohAnchorClient(endpoint, timeout_s=20) as client,
        ThreadPoolExecutor(64) as pool,
        ThreadPoolExecutor(1) as clock,
    ):
        client.plan_request(request)  # connect

        def ask_by_the_clock() -> list[Future[AnchorBatch]]:
            """Send a request every tick, whether the one before is answered or not."""
            start, answers = time.monotonic(), []
            for tick in range(int(HZ * SECONDS)):
                time.sleep(max(0.0, start + tick / HZ - time.monotonic()))
                answers.append(pool.submit(client.plan_request, request))
            return answers

        asking = clock.submit(ask_by_the_clock)
        time.sleep(KILL_AT * SECONDS)
        so_far = len(caplog.records)
        until(lambda: told(caplog.records[so_far:], "asking"))
        (killed, *_) = told(caplog.records[so_far:], "asking")
        two[killed].kill()  # in the middle of its answer
        time.sleep((BACK_AT - KILL_AT) * SECONDS)
        two[killed].start()
        so_far = len(caplog.records)
        for answer in asking.result():
            answer.result()  # no request is lost
        # It answers again, if need be after the run: on a busy machine it starts slowly.
        until(
            lambda: (
                client.plan_request(request)
                and told(caplog.records[so_far:], "answered in")[killed]
            )
        )

    assert told(caplog.records, "nothing came")[killed] >= 1  # it was queried, and died
    (other,) = {"a", "b"} - {killed}
    assert told(caplog.records, "answered in")[other] >= 1


def test_without_any_replica_left_the_connection_fails(
    two: dict[str, Program], endpoint: str, fields: dict[str, Any]
) -> None:
    with ZenohAnchorClient(endpoint, timeout_s=20) as client:
        client.plan(**fields)
        for process in two.values():
            process.kill()
        with pytest.raises(ConnectionFailed):
            client.plan(**fields)
