"""A ticket ends once, and whoever works on it learns that nobody waits any more."""

from __future__ import annotations

import pytest

from anchorflow_client import DeadlineExceeded, NotReady
from anchorflow_service.planning import Arrival, Turn
from anchorflow_service.planning.job import CalledOff, Ticket


def test_a_job_learns_how_long_it_waited_and_what_it_may_use() -> None:
    ticket: Ticket[Turn] = Ticket(lambda turn: turn, Arrival())

    assert ticket.work(queue_ms=12.0, threads=3)
    turn = ticket.result.result(0)
    assert (turn.queue_ms, turn.threads) == (12.0, 3)


def test_what_a_job_raises_is_its_result() -> None:
    ticket: Ticket[float] = Ticket(lambda _: 1 / 0, Arrival())

    assert not ticket.work(queue_ms=0.0, threads=1)
    with pytest.raises(ZeroDivisionError):
        ticket.result.result(0)


def test_called_off_in_the_queue_it_is_not_worked_on() -> None:
    done: list[Turn] = []
    ticket: Ticket[None] = Ticket(done.append, Arrival())
    ticket.call_off(NotReady("the service is stopping"))

    assert not ticket.work(queue_ms=0.0, threads=1)
    assert done == []
    with pytest.raises(NotReady):
        ticket.result.result(0)


def test_called_off_at_work_it_stops_at_the_next_check() -> None:
    reached: list[str] = []

    def job(turn: Turn) -> None:
        turn.check()
        reached.append("first step")
        ticket.call_off(NotReady("the service is stopping"))
        turn.check()
        reached.append("second step")

    ticket: Ticket[None] = Ticket(job, Arrival())

    assert not ticket.work(queue_ms=0.0, threads=1)
    assert reached == ["first step"]
    assert isinstance(ticket.result.exception(0), NotReady)  # and not CalledOff, which is for us


def test_the_first_end_stands() -> None:
    ticket: Ticket[str] = Ticket(lambda _: "done", Arrival())

    assert ticket.work(queue_ms=0.0, threads=1)
    ticket.call_off(CalledOff())
    assert ticket.result.result(0) == "done"


def test_a_budget_that_runs_out_at_work_ends_it_at_the_next_check() -> None:
    now = [7.0]

    def job(turn: Turn) -> None:
        turn.check()
        now[0] += 0.3
        turn.check()

    ticket: Ticket[None] = Ticket(job, Arrival(clock=lambda: now[0]), budget_ms=250)

    assert not ticket.work(queue_ms=0.0, threads=1)
    with pytest.raises(
        DeadlineExceeded, match=r"within 250 ms, 300\.0 ms had passed while planning"
    ):
        ticket.result.result(0)
