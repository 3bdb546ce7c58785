"""A job ends once, and its work stops at the next check after it was cancelled."""

from __future__ import annotations

from typing import Any

import pytest

from anchorflow_client import NotReady, Superseded
from anchorflow_service.planning import Arrival, JobContext
from anchorflow_service.planning.job import Job, JobCancelled
from anchorflow_service.planning.service import LatestPerRobot


@pytest.mark.parametrize("where", ["work", "deliver"])
def test_what_is_raised_at_work_or_on_delivery_is_the_result(where: str) -> None:
    calls: dict[str, Any] = {"work": lambda _: 0.0, "deliver": lambda _: None}
    calls[where] = lambda _: 1 / 0
    job: Job[float] = Job(arrival=Arrival(), **calls)

    assert job.run(queue_ms=0.0, threads=1) == (where == "deliver")
    with pytest.raises(ZeroDivisionError):
        job.result.result(0)


def test_the_first_end_stands() -> None:
    job: Job[str] = Job(lambda _: "done", Arrival())

    assert job.run(queue_ms=0.0, threads=1)
    job.cancel(JobCancelled())
    assert job.result.result(0) == "done"


def test_a_result_is_delivered_before_anybody_else_has_it() -> None:
    delivered: list[tuple[str, bool]] = []
    job: Job[str] = Job(
        lambda _: "done",
        Arrival(),
        deliver=lambda result: delivered.append((result, job.result.done())),
    )

    assert job.run(queue_ms=0.0, threads=1)
    assert delivered == [("done", False)]
    assert job.result.result(0) == "done"


def test_what_nobody_waits_for_is_not_delivered() -> None:
    delivered: list[str] = []

    def work(_: JobContext) -> str:
        job.cancel(NotReady("the service is stopping"))
        return "done"

    job: Job[str] = Job(work, Arrival(), deliver=delivered.append)

    job.run(queue_ms=0.0, threads=1)
    assert delivered == []
    assert isinstance(job.result.exception(0), NotReady)


# The latest job of a robot wins, by the time of arrival and not by that of reading.


def job_of(arrived: float = 7.0) -> Job[None]:
    return Job(lambda _: None, Arrival(clock=lambda: arrived))


def test_an_older_request_that_took_longer_to_read_is_superseded() -> None:
    latest, older, newer = LatestPerRobot(), job_of(7.0), job_of(8.0)

    with latest.registered("r1", newer):
        with pytest.raises(Superseded), latest.registered("r1", older):
            raise AssertionError
        assert not newer.has_ended


def test_nothing_is_kept_of_those_who_are_answered() -> None:
    latest, first, second = LatestPerRobot(), job_of(7.0), job_of(8.0)

    with latest.registered("r1", first), latest.registered("r1", second):
        pass
    assert len(latest) == 0
