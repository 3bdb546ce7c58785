"""Scores, tables and the file of runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from anchorflow_benchmarks import BenchmarkError
from anchorflow_benchmarks.closed_loop.drive import End, Run
from anchorflow_benchmarks.closed_loop.results import Result, RunLog, barn_score, contest_tables


def run_of(end: End, time_s: float = 10.0) -> Run:
    return Run(end, time_s, clearance=0.1, length=2.0 * time_s, ticks_braked=1)


@pytest.mark.parametrize(
    ("time_s", "score"),
    [(5.0, 0.5), (12.0, 0.5), (18.0, 1 / 3), (48.0, 0.125), (49.9, 0.125)],
)
def test_a_way_of_12_m_has_a_best_time_of_6_s(time_s: float, score: float) -> None:
    assert barn_score(run_of(End.GOAL, time_s), 12.0) == pytest.approx(score)


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


def test_runs_of_other_settings_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "runs.jsonl"
    RunLog(path, {"robot": "unicycle"}).known()
    with pytest.raises(
        BenchmarkError, match=r"robot: expected runs of 'double-integrator', got runs of 'unicycle'"
    ):
        RunLog(path, {"robot": "double-integrator"}).known()
    with pytest.raises(BenchmarkError, match="limit: expected runs of '9 s', got runs of None"):
        RunLog(path, {"robot": "unicycle", "limit": "9 s"}).known()


@pytest.mark.parametrize(
    "content", [b"[]\nrubbish\n", b"[1]\n", b"{}\n[]\n", b"\xff\xfe\x00\n", b"a line alone"]
)
def test_what_is_no_file_of_runs_is_left_alone(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "runs.jsonl"
    path.write_bytes(content)

    with pytest.raises(BenchmarkError, match=r"runs\.jsonl: not a file of runs"):
        RunLog(path, {}).known()

    assert path.read_bytes() == content


def test_a_full_disk_is_named(tmp_path: Path) -> None:
    log = RunLog(tmp_path / "runs.jsonl", {"robot": "unicycle"})
    log.path.symlink_to("/dev/full")
    with pytest.raises(BenchmarkError, match=r"runs\.jsonl: No space left"):
        log.add(Result("MPPI", "a", 0, 6.0, Run(End.GOAL, 3.0, 0.1, 4.0, 0), ()))


def test_a_file_that_was_cut_off_goes_on(tmp_path: Path) -> None:
    log = RunLog(tmp_path / "new" / "runs.jsonl", {"robot": "unicycle"})
    first, second = (
        Result("MPPI", name, 0, 6.0, Run(End.GOAL, 3.0, 0.1, 4.0, 0), ()) for name in ("a", "b")
    )
    log.known()
    settings = log.path.read_bytes()
    log.add(first)
    log.add(second)
    whole = log.path.read_bytes()

    for end in range(len(settings)):
        log.path.write_bytes(settings[:end])
        assert log.known() == {}
        assert log.path.read_bytes() == settings
    for end in range(len(whole) - 9, len(whole)):
        log.path.write_bytes(whole[:end])
        assert list(log.known().values()) == [first]
        log.add(second)
        assert log.path.read_bytes() == whole
