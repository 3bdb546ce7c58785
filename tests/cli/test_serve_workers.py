"""`anchorflow serve --workers 2`: real processes, killed as they come."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from anchorflow_cli.main import main
from anchorflow_cli.serving import ServeChoice
from anchorflow_client import (
    AnchorClient,
    AnchorFlowError,
    AnchorRequest,
    InvalidRequest,
    RetryingClient,
)
from anchorflow_client.errors import RequestError
from anchorflow_service.bundle import DEFAULT_BUNDLE
from anchorflow_service.http.connections import ConnectionLimits
from anchorflow_service.http.lifecycle import Draining, TlsFiles
from anchorflow_service.planning import ServiceLimits

pytestmark = pytest.mark.skipif(
    not Path("/proc/self/task").exists(), reason="finds the workers in /proc"
)

COMMAND = ("serve", "--port", "0", "--workers", "2", "--threads", "1", "--drain-s", "5")
REQUEST = AnchorRequest.build(
    cost_map={"data": np.zeros((1, 64, 64)), "resolution": 0.16},
    x_curr=[-3, 0, 0, 0, 0, 0],
    x_goal=[3, 0, 0, 0],
    num_samples=2,
    sampler={"method": "midpoint", "schedule": {"uniform": 2}},
)
PATIENCE_S = 100.0


class Served:
    """The command, which serves; ended at the end of the test."""

    def __init__(self, *options: str, first: str = "") -> None:
        """first: what the process does before it serves"""
        program = f"{first}\nfrom anchorflow_cli.main import main; main()"
        self.process = subprocess.Popen(
            [sys.executable, "-u", "-c", program, *COMMAND, *options],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert self.process.stdout is not None
        self.line = self.process.stdout.readline().rstrip("\n")
        self.url = self.line.partition(" at ")[2].partition(" ")[0]

    def workers(self) -> set[int]:
        """Their processes; the standard library has one of its own beside them."""
        pid = self.process.pid
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        return {int(child) for child in children if "spawn_main" in commandline(int(child))}

    def ended(self) -> tuple[int, list[str]]:
        """Waits for the end: its status, and the lines on stderr."""
        _, errors = self.process.communicate(timeout=60)
        return self.process.returncode, errors.splitlines()


def commandline(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return ""


def is_gone(pid: int) -> bool:
    return "spawn_main" not in commandline(pid)


@pytest.fixture
def serve() -> Iterator[Callable[..., Served]]:
    started: list[Served] = []

    def start(*options: str, first: str = "") -> Served:
        started.append(Served(*options, first=first))
        return started[-1]

    yield start
    for each in started:
        each.process.kill()
        each.process.communicate(timeout=20)


@pytest.fixture
def replacement(until: Any) -> Callable[[Served, set[int]], int]:
    """Waits for a worker that was not there before."""

    def find(served: Served, before: set[int]) -> int:
        until(lambda: served.workers() - before)
        (new,) = served.workers() - before
        return new

    return find


class Crowd:
    """Retrying clients that plan without a pause until `stop` is called."""

    def __init__(self, url: str, clients: int = 3) -> None:
        self.answers = 0
        self.failures: list[AnchorFlowError] = []
        self._stop = threading.Event()
        self._threads = [threading.Thread(target=self._ask, args=(url,)) for _ in range(clients)]
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        self._stop.set()
        for thread in self._threads:
            thread.join(PATIENCE_S + 30)

    def has_more(self, more: int) -> Callable[[], bool]:
        """Return a check for that many more answers, or for a failure, which ends the wait."""
        goal = self.answers + more
        return lambda: self.answers >= goal or bool(self.failures)

    def _ask(self, url: str) -> None:
        with RetryingClient(AnchorClient(url), patience_s=PATIENCE_S) as client:
            while not self._stop.is_set():
                try:
                    client.plan_request(REQUEST)
                    self.answers += 1
                except AnchorFlowError as error:  # noqa: PERF203
                    self.failures.append(error)


def test_workers_that_are_killed_are_replaced_and_no_request_fails(
    serve: Callable[..., Served], replacement: Callable[[Served, set[int]], int], until: Any
) -> None:
    served = serve()
    first, second = sorted(served.workers())
    crowd = Crowd(served.url)
    until(crowd.has_more(10))

    os.kill(first, signal.SIGKILL)
    third = replacement(served, {first, second})
    os.kill(second, signal.SIGKILL)  # from now on only a worker that came later can answer
    fourth = replacement(served, {first, second, third})
    until(crowd.has_more(20))
    crowd.stop()

    assert crowd.failures == []
    assert served.workers() == {third, fourth}
    served.process.send_signal(signal.SIGTERM)
    assert served.ended() == (0, [])


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_all_of_them(serve: Callable[..., Served], number: signal.Signals) -> None:
    served = serve()
    workers = served.workers()
    assert served.line.startswith("flowmp-small ")
    assert served.line.endswith("), 2 workers")
    assert len(workers) == 2

    served.process.send_signal(number)
    code, lines = served.ended()

    assert (code, lines) == (0, [])
    assert all(map(is_gone, workers))
    assert not AnchorClient(served.url).live()


def test_a_signal_to_every_process_is_one_signal(serve: Callable[..., Served], until: Any) -> None:
    """As systemd sends it: the supervisor's own signal to its workers does not end the notice."""
    served = serve("--notice-s", "2")
    workers = served.workers()
    with AnchorClient(served.url) as client:
        for pid in (*workers, served.process.pid):
            os.kill(pid, signal.SIGTERM)
        until(lambda: not client.ready())

        # A worker whose notice had ended would be gone by then.
        with pytest.raises(subprocess.TimeoutExpired):
            served.process.wait(1.0)
        assert served.workers() == workers
        assert client.plan_request(REQUEST).model.name == "flowmp-small"
    assert served.ended() == (0, [])


def test_workers_do_not_outlive_their_supervisor(serve: Callable[..., Served], until: Any) -> None:
    served = serve()
    workers = served.workers()

    served.process.kill()

    until(lambda: all(map(is_gone, workers)))


def test_a_worker_that_cannot_be_replaced_is_tried_again_while_another_serves(
    serve: Callable[..., Served], tmp_path: Path
) -> None:
    bundle = Path(shutil.copytree(DEFAULT_BUNDLE, tmp_path / "bundle"))
    served = serve("--bundle", str(bundle))
    before = served.workers()
    manifest = bundle / "manifest.json"
    whole = manifest.read_bytes()
    manifest.unlink()

    os.kill(min(before), signal.SIGKILL)
    assert served.process.stderr is not None
    reason = f"a worker cannot start: {manifest}: cannot be read: No such file or directory"
    assert reason in served.process.stderr.readline()
    with RetryingClient(AnchorClient(served.url)) as client:
        assert client.plan_request(REQUEST).model.name == "flowmp-small"

    manifest.write_bytes(whole)
    served.process.send_signal(signal.SIGTERM)
    assert served.ended()[0] == 0


def test_workers_that_cannot_start_end_the_command(
    serve: Callable[..., Served], tmp_path: Path
) -> None:
    served = serve("--bundle", str(tmp_path))

    code, lines = served.ended()
    assert (code, served.line) == (1, "")
    assert f"a worker cannot start: {tmp_path}/manifest.json: cannot be read" in lines[0]
    assert lines[-1] == "anchorflow serve: a worker cannot start"


def counted(url: str) -> float:
    """Return the number of answered planning requests in the metrics of one worker."""
    with urllib.request.urlopen(f"{url}/metrics", timeout=20) as answer:
        lines = answer.read().decode().splitlines()
    labels = '{model="flowmp-small",outcome="ok",transport="http"}'
    return sum(float(line.split()[-1]) for line in lines if f"requests_total{labels}" in line)


def test_workers_keep_their_models_and_count_together(
    serve: Callable[..., Served], replacement: Callable[[Served, set[int]], int]
) -> None:
    served = serve("--drain-s", "3e6")
    before = served.workers()
    for action in ("load", "unload"):
        url = f"{served.url}/v2/repository/models/flowmp-small/{action}"
        with pytest.raises(urllib.error.HTTPError) as caught:
            urllib.request.urlopen(urllib.request.Request(url, data=b"{}"), timeout=20)
        with caught.value as answer:
            error = RequestError.from_dict(json.load(answer))
        assert isinstance(error, InvalidRequest)
        assert "expected a service of one worker: this one has several" in error.message
    for _ in range(12):  # a connection each, so that both workers are asked
        with AnchorClient(served.url) as client:
            client.plan_request(REQUEST)

    assert [counted(served.url) for _ in range(8)] == [12.0] * 8

    os.kill(min(before), signal.SIGTERM)  # a new bundle is rolled out like this
    replacement(served, before)
    assert counted(served.url) == 12.0


def test_a_folder_of_counts_that_is_cleared_away_is_made_anew(
    serve: Callable[..., Served],
    replacement: Callable[[Served, set[int]], int],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    served = serve()
    before = served.workers()
    shutil.rmtree(next(tmp_path.glob("anchorflow-metrics-*")))

    for pid in sorted(before):
        os.kill(pid, signal.SIGKILL)
        before.add(replacement(served, before))
    with AnchorClient(served.url) as client:
        client.plan_request(REQUEST)

    assert counted(served.url) == 1.0


def test_threads_are_shared_out_unless_they_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("anchorflow_cli.serving.usable_cores", lambda: 8)

    def threads(workers: int, named: int | None = None) -> int | None:
        choice = ServeChoice(
            bundles=None,
            repository=None,
            provider="cpu",
            tokens=None,
            tls=TlsFiles(),
            connections=ConnectionLimits(),
            limits=ServiceLimits(threads=named),
            draining=Draining(),
            traces=None,
            log_format="text",
            log_level="warning",
            workers=workers,
        )
        return choice.with_shared_threads().limits.threads

    assert [threads(n) for n in (2, 3, 16)] == [4, 2, 1]
    assert threads(3, named=5) == 5


def test_several_workers_and_zenoh_do_not_go_together() -> None:
    with pytest.raises(SystemExit) as caught:
        main(["serve", "--port", "0", "--workers", "2", "--zenoh", "peer"])

    assert str(caught.value.code).startswith("anchorflow serve: --workers: expected 1 with --zenoh")
