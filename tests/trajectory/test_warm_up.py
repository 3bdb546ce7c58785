"""What is compiled at a start: each loop for what a scene needs, with and without moving discs."""

from __future__ import annotations

import signal
import time
from typing import Any

import numba
import pytest

from anchorflow_trajectory import warm_up
from anchorflow_trajectory.finish import bisection, certificate, optimisation_pass
from anchorflow_trajectory.movers import Discs


def takes_discs(dispatcher: Any) -> list[bool]:
    """Whether each of the types that a loop is compiled for has moving discs."""
    return sorted(Discs.__name__ in str(types) for types in dispatcher.overloads)


def test_each_loop_is_compiled_without_discs_and_with_them() -> None:
    warm_up.compile_loops()
    for loop in (optimisation_pass._run, bisection._bisect, certificate._are_safe):
        assert takes_discs(loop) == [False, True]
    assert all(map(warm_up.is_kept, warm_up.STAGES))


def test_machine_code_of_another_numba_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    warm_up.compile_loops()
    monkeypatch.setattr(numba, "__version__", "0")
    assert not warm_up.is_kept(warm_up.STILL)


def test_a_stage_that_there_is_not_is_refused() -> None:
    with pytest.raises(
        SystemExit, match="expected stages of still, moving, poses, guard, foresight, got"
    ):
        warm_up.main(["walking"])


@pytest.mark.parametrize("after_s", [0.01, 0.02, 0.04, 0.08])
def test_a_compiler_ends_at_ctrl_c_without_a_word(
    after_s: float, capfd: pytest.CaptureFixture[str]
) -> None:
    with warm_up.compiler("moving") as process:
        time.sleep(after_s)
        process.send_signal(signal.SIGINT)
    assert process.returncode == -signal.SIGINT
    assert capfd.readouterr().err == ""
