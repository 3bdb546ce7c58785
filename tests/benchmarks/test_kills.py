"""Processes killed under load: who is found, and what a run tells."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from anchorflow_benchmarks.linux_processes import descendants
from anchorflow_benchmarks.planners import limits_of, request_of
from anchorflow_benchmarks.samplers import CARD, parse_sampler
from anchorflow_benchmarks.scene_files import load_scenes
from anchorflow_benchmarks.serving import kills
from anchorflow_benchmarks.serving.kills import KillConfig, kill_table
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle

pytestmark = pytest.mark.skipif(
    not Path("/proc/self").exists(), reason="processes are found in /proc"
)
STUDENT = DEFAULT_BUNDLE.parent / "student"
GRANDCHILD = "import subprocess, sys; subprocess.run([sys.executable, '-c', sys.argv[1]])"
WAIT = "print('marked', flush=True); input()"


def test_processes_are_found_among_the_descendants_by_their_words() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", GRANDCHILD, WAIT],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as child:
        assert child.stdin is not None
        assert child.stdout is not None
        child.stdout.readline()
        found = descendants(os.getpid(), "marked")

        assert child.pid in found
        assert len(found) == 2
        assert descendants(child.pid, "marked") == found - {child.pid}
        assert descendants(os.getpid(), "not there") == set()
        child.stdin.close()


def test_a_worker_is_killed_and_every_answer_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kills, "find_spec", lambda _: None)  # Ray has a test of its own
    bundle = load_bundle(STUDENT)
    sampler = parse_sampler(CARD, bundle.card)
    scenes = load_scenes("drawn:2:0", limits=limits_of(bundle))
    requests = [request_of(scene, num=2, seed=1, sampler=sampler) for scene in scenes]

    table = kill_table(STUDENT, requests, KillConfig(clients=2, seconds=4.0, kills=1))

    (row,) = table.rows
    assert (row["killed"], row["kills"]) == ("worker of serve --workers 2", 1)
    assert (row["failed"], row["errors"]) == (0, "none")
    assert row["answered by"] == f"{bundle.card.name} {bundle.card.version} {row['answers']}"
    assert "Ray is not installed here" in table.note
