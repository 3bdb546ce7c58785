"""Answers arrive in simulated time when they are due, not before."""

from __future__ import annotations

import pytest

from anchorflow_benchmarks.closed_loop.simulated_time import LatencyExecutor, SimulatedTime
from anchorflow_client import ConnectionFailed


def test_what_is_due_happens_in_its_order() -> None:
    clock, seen = SimulatedTime(), []
    for moment in (0.3, 0.1, 0.2, 0.1):
        clock.at(moment, lambda moment=moment: seen.append((moment, clock.now)))
    clock.advance(0.05)
    assert seen == []
    clock.advance(0.2)
    assert [moment for moment, _ in seen] == [0.1, 0.1, 0.2]
    clock.advance(1.0)
    assert [moment for moment, _ in seen] == [0.1, 0.1, 0.2, 0.3]


def test_an_answer_takes_its_latency() -> None:
    clock = SimulatedTime()
    future = LatencyExecutor(clock, fixed_s=0.25).submit(lambda a, b: a + b, 1, b=2)
    clock.advance(0.2)
    assert not future.done()
    clock.advance(0.05)
    assert future.result(timeout=0) == 3


def test_a_measured_latency_is_kept() -> None:
    clock, watch = SimulatedTime(), iter([7.0, 7.4])
    executor = LatencyExecutor(clock, stopwatch=lambda: next(watch))
    future = executor.submit(sum, [1, 2])
    assert executor.latencies_s == pytest.approx([0.4])
    clock.advance(0.39)
    assert not future.done()
    clock.advance(0.02)
    assert future.result(timeout=0) == 3


def test_a_failure_takes_its_time_too() -> None:
    def fail() -> None:
        raise ConnectionFailed("nobody listens")

    clock = SimulatedTime()
    future = LatencyExecutor(clock, fixed_s=0.1).submit(fail)
    assert not future.done()
    clock.advance(0.1)
    with pytest.raises(ConnectionFailed, match="nobody listens"):
        future.result(timeout=0)
