"""A contest that was cut off goes on where it was."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from anchorflow_benchmarks.closed_loop.contest import Contender, ContestConfig, run_contest
from anchorflow_benchmarks.closed_loop.drive import DriveConfig, End, Run
from anchorflow_benchmarks.closed_loop.mppi import MppiConfig
from anchorflow_benchmarks.closed_loop.run_log import RunLog
from anchorflow_benchmarks.closed_loop.scoring import Result
from anchorflow_benchmarks.closed_loop.world import World
from anchorflow_benchmarks.errors import BenchmarkError
from anchorflow_service.bundle import DEFAULT_BUNDLE

ALONE = Contender("MPPI", None, 16)
CONFIG = ContestConfig(
    bundle=DEFAULT_BUNDLE,
    mppi=MppiConfig(steps=5),
    drive=DriveConfig(limit_s=0.2, map_cells=32, map_resolution=0.2),
)


def test_what_is_known_is_not_driven_again(tmp_path: Path, world: Callable[..., World]) -> None:
    log = RunLog(tmp_path / "runs.jsonl", {"robot": "unicycle"})
    known = Result("MPPI", "one", 0, 6.0, Run(End.COLLISION, 3.0, -0.01, 4.0, 0), (60.0,))
    log.known()
    log.add(known)
    worlds = [world(name="one"), world(name="two")]
    results = run_contest([ALONE], worlds, CONFIG, log=log)

    assert results[0] == known
    assert results[1].run.end is End.TIMEOUT
    assert log.known() == {("MPPI", r.world, 0): r for r in results}


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
