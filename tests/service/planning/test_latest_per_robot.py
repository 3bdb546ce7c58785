"""Latest wins, by the time of arrival and not by that of reading."""

from __future__ import annotations

import pytest

from anchorflow_client import Superseded
from anchorflow_service.planning import Arrival
from anchorflow_service.planning.job import Ticket
from anchorflow_service.planning.latest_per_robot import Robots


def ticket(arrived: float = 7.0) -> Ticket[None]:
    return Ticket(lambda _: None, Arrival(clock=lambda: arrived))


def test_a_newer_request_takes_the_place_of_the_older() -> None:
    robots, older, newer = Robots(), ticket(7.0), ticket(8.0)

    with robots.newest("r1", older), robots.newest("r1", newer):
        error = older.result.exception(0)
        assert isinstance(error, Superseded)
        assert (error.http_status, error.field) == (409, "robot_id")
        assert "robot_id 'r1'" in error.message
        assert not newer.has_ended


def test_an_older_request_that_took_longer_to_read_does_not() -> None:
    robots, older, newer = Robots(), ticket(7.0), ticket(8.0)

    with robots.newest("r1", newer):
        with pytest.raises(Superseded), robots.newest("r1", older):
            raise AssertionError
        assert not newer.has_ended


def test_robots_do_not_touch_each_other() -> None:
    robots, one, other, nobody = Robots(), ticket(), ticket(), ticket()

    with robots.newest("r1", one), robots.newest("r2", other), robots.newest(None, nobody):
        assert not any(each.has_ended for each in (one, other, nobody))


def test_who_names_no_robot_supersedes_nobody() -> None:
    robots, one, other = Robots(), ticket(7.0), ticket(8.0)

    with robots.newest(None, one), robots.newest(None, other):
        assert not one.has_ended


def test_nothing_is_kept_of_those_who_are_answered() -> None:
    robots, first, second = Robots(), ticket(7.0), ticket(8.0)

    with robots.newest("r1", first), robots.newest("r1", second):
        pass
    assert len(robots) == 0
