"""A service answers before it can answer requests with obstacles, and says so."""

from __future__ import annotations

import subprocess
import sys
import threading

import pytest

from anchorflow_client.errors import NotReady
from anchorflow_service.engine import later_loops
from anchorflow_service.engine.later_loops import LaterLoops

SECONDS = 20.0


def test_what_is_deferred_is_refused_until_it_is_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    compiled, goes_on = list[str](), threading.Event()

    def compile_loops(stage: str) -> None:
        compiled.append(stage)
        if stage == "moving":
            assert goes_on.wait(SECONDS)

    def compiler(stage: str) -> subprocess.Popen[bytes]:
        assert stage == "moving"
        return subprocess.Popen([sys.executable, "-c", "pass"])

    monkeypatch.setattr(later_loops, "is_kept", lambda _: False)
    monkeypatch.setattr(later_loops, "compile_loops", compile_loops)
    monkeypatch.setattr(later_loops, "compiler", compiler)
    loops = LaterLoops("moving", "obstacles")
    loops.defer()
    loops.load()
    assert compiled == ["still"]
    thread = threading.Thread(target=loops.compile)
    thread.start()
    with pytest.raises(NotReady, match=r"moving obstacles .* for about \d+ s more"):
        loops.require()
    goes_on.set()
    thread.join(SECONDS)
    loops.require()
    assert compiled == ["still", "moving"]


def test_what_is_on_disk_is_loaded_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    compiled = list[str]()
    monkeypatch.setattr(later_loops, "is_kept", lambda _: True)
    monkeypatch.setattr(later_loops, "compile_loops", compiled.append)
    loops = LaterLoops("moving", "obstacles")
    loops.defer()
    loops.load()
    loops.compile()
    loops.require()
    assert compiled == ["still", "moving"]


def test_what_a_program_leaves_is_compiled_by_the_request_that_needs_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    compiled = list[str]()
    monkeypatch.setattr(later_loops, "compile_loops", compiled.append)
    loops = LaterLoops("moving", "obstacles")
    loops.on_demand()
    loops.load()
    assert compiled == ["still"]
    loops.require()
    assert compiled == ["still", "moving"]
