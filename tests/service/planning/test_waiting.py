"""The line, the batch at its head, and who has no place in it any more."""

from __future__ import annotations

from collections.abc import Hashable

from anchorflow_client import DeadlineExceeded
from anchorflow_service.planning import Arrival
from anchorflow_service.planning.job import Job, JobCancelled, WaitingLine


def job(key: Hashable = None, *, budget_ms: float | None = None) -> Job[None]:
    return Job(lambda _: None, Arrival(clock=lambda: 7.0), key=key, budget_ms=budget_ms)


def line_of(*jobs: Job[None]) -> WaitingLine:
    line = WaitingLine()
    for each in jobs:
        line.add(each)
    return line


def test_a_batch_is_the_oldest_and_those_of_its_key_in_order() -> None:
    a1, b1, a2, b2, a3 = (job(key) for key in "ababa")
    line = line_of(a1, b1, a2, b2, a3)

    assert line.batch(16) == [a1, a2, a3]
    assert line.batch(2) == [a1, a2]
    assert line.batch(1) == [a1]
    assert line.count() == 5  # they stay until they are taken

    line.remove([a1, a2])
    assert line.batch(16) == [b1, b2]


def test_who_has_no_key_is_alone() -> None:
    one, other = job(), job()
    line = line_of(one, other)

    assert line.batch(16) == [one]
    line.remove([one])
    assert line.batch(16) == [other]


def test_an_empty_line_has_no_batch() -> None:
    assert WaitingLine().batch(16) == []


def test_who_was_called_off_takes_no_place() -> None:
    gone, here = job("a"), job("a")
    line = line_of(gone, here)
    gone.cancel(JobCancelled())

    assert line.count() == 1
    assert line.batch(16) == [here]


def test_whose_budget_is_spent_is_told_and_takes_no_place() -> None:
    now = [7.0]
    late: Job[None] = Job(lambda _: None, Arrival(clock=lambda: now[0]), budget_ms=50)
    here = job("a")
    line = line_of(late, here)
    now[0] = 7.06

    assert line.batch(16) == [here]
    error = late.result.exception(0)
    assert isinstance(error, DeadlineExceeded)
    assert "60.0 ms had passed in the queue" in error.message


def test_who_leaves_may_do_so_twice() -> None:
    here = job()
    line = line_of(here)
    line.discard(here)
    line.discard(here)

    assert line.count() == 0


def test_clearing_hands_out_all() -> None:
    jobs = [job(), job()]
    line = line_of(*jobs)

    assert line.clear() == jobs
    assert line.count() == 0
