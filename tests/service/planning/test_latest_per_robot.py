"""Latest wins, by the time of arrival and not by that of reading."""

from __future__ import annotations

import pytest

from anchorflow_client import Superseded
from anchorflow_service.planning import Arrival
from anchorflow_service.planning.job import Job
from anchorflow_service.planning.service import LatestPerRobot


def job(arrived: float = 7.0) -> Job[None]:
    return Job(lambda _: None, Arrival(clock=lambda: arrived))


def test_a_newer_request_takes_the_place_of_the_older() -> None:
    latest, older, newer = LatestPerRobot(), job(7.0), job(8.0)

    with latest.registered("r1", older), latest.registered("r1", newer):
        error = older.result.exception(0)
        assert isinstance(error, Superseded)
        assert (error.http_status, error.field) == (409, "robot_id")
        assert "robot_id 'r1'" in error.message
        assert not newer.has_ended


def test_an_older_request_that_took_longer_to_read_does_not() -> None:
    latest, older, newer = LatestPerRobot(), job(7.0), job(8.0)

    with latest.registered("r1", newer):
        with pytest.raises(Superseded), latest.registered("r1", older):
            raise AssertionError
        assert not newer.has_ended


def test_robots_do_not_touch_each_other() -> None:
    latest, one, other, nobody = LatestPerRobot(), job(), job(), job()

    with (
        latest.registered("r1", one),
        latest.registered("r2", other),
        latest.registered(None, nobody),
    ):
        assert not any(each.has_ended for each in (one, other, nobody))


def test_nothing_is_kept_of_those_who_are_answered() -> None:
    latest, first, second = LatestPerRobot(), job(7.0), job(8.0)

    with latest.registered("r1", first), latest.registered("r1", second):
        pass
    assert len(latest) == 0
