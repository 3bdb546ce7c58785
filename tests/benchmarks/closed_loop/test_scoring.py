"""The challenge's score, and what the tables make of it."""

from __future__ import annotations

import pytest

from anchorflow_benchmarks.closed_loop.drive import End, Run
from anchorflow_benchmarks.closed_loop.scoring import Result, barn_score, contest_tables


def run_of(end: End, time_s: float = 10.0) -> Run:
    return Run(end, time_s, clearance=0.1, length=2.0 * time_s, ticks_braked=1)


@pytest.mark.parametrize(
    ("time_s", "score"),
    [(5.0, 0.5), (12.0, 0.5), (18.0, 1 / 3), (48.0, 0.125), (49.9, 0.125)],
)
def test_a_way_of_12_m_has_a_best_time_of_6_s(time_s: float, score: float) -> None:
    assert barn_score(run_of(End.GOAL, time_s), 12.0) == pytest.approx(score)


@pytest.mark.parametrize("end", [End.COLLISION, End.TIMEOUT])
def test_a_run_that_does_not_arrive_scores_nothing(end: End) -> None:
    assert barn_score(run_of(end), 12.0) == 0.0


def result(contender: str, world: str, end: End, time_s: float = 10.0, ms: float = 50.0) -> Result:
    return Result(contender, world, 0, 12.0, run_of(end, time_s), (ms,))


def test_the_tables_of_a_contest() -> None:
    results = [
        result("a", "w1", End.GOAL, 18.0),
        result("b", "w1", End.GOAL, 12.0, ms=40.0),
        result("a", "w2", End.COLLISION),
        result("b", "w2", End.TIMEOUT, ms=60.0),
        result("a", "w3", End.GOAL, 12.0),
        result("b", "w3", End.GOAL, 12.0, ms=50.0),
    ]
    contenders, worlds = contest_tables(results, ["a", "b"])

    first, second = contenders.rows
    assert first["score"] == pytest.approx((1 / 3 + 0.5) / 3)
    assert (first["gain"], first["±"]) == (None, None)
    assert second["gain"] == pytest.approx((0.5 - 1 / 3) / 3)
    # Gains of 1/6, 0 and 0: standard deviation 1/6 / sqrt(3), over sqrt(3) worlds.
    assert second["±"] == pytest.approx(1.96 / 6 / 3)
    assert [first[key] for key in ("arrived", "collisions", "timeouts")] == [2, 1, 0]
    assert [second[key] for key in ("arrived", "collisions", "timeouts")] == [2, 0, 1]
    assert (first["time s"], second["time s"]) == (15.0, 12.0)
    assert second["speed m/s"] == pytest.approx(2.0)
    assert second["request p50 ms"] == 50.0
    assert worlds.rows == [
        {"world": "w1", "a": "0.333", "b": "0.500"},
        {"world": "w2", "a": "collision", "b": "timeout"},
        {"world": "w3", "a": "0.500", "b": "0.500"},
    ]


def test_the_seeds_of_a_world_count_as_one() -> None:
    results = [
        Result(name, "w1", seed, 12.0, run_of(end))
        for name, ends in (("a", (End.GOAL, End.COLLISION)), ("b", (End.GOAL, End.GOAL)))
        for seed, end in enumerate(ends)
    ]
    contenders, worlds = contest_tables(results, ["a", "b"])

    assert contenders.rows[1]["gain"] == pytest.approx(0.25)
    assert worlds.rows == [{"world": "w1", "a": "0.500 collision", "b": "0.500 0.500"}]
