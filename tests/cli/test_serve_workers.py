"""`anchorflow serve --workers 2`: real processes, killed as they come."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import threading
import urllib.error
import urllib.request
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import Served, failure

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

REQUEST = AnchorRequest.build(
    cost_map={"data": np.zeros((1, 64, 64)), "resolution": 0.16},
    x_curr=[-3, 0, 0, 0, 0, 0],
    x_goal=[3, 0, 0, 0],
    num_samples=2,
    sampler={"method": "midpoint", "schedule": {"uniform": 2}},
)
PATIENCE_S = 100.0


def workers_of(served: Served) -> set[int]:
    """Return their processes; the standard library has one of its own beside them."""
    pid = served.process.pid
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return {int(child) for child in children if "spawn_main" in commandline(int(child))}


def commandline(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return ""


def is_gone(pid: int) -> bool:
    return "spawn_main" not in commandline(pid)


@pytest.fixture
def start(serve: Callable[..., Served]) -> Callable[..., Served]:
    """Start a service of two workers."""
    return partial(serve, "--workers", "2", "--threads", "1", "--drain-s", "5")


@pytest.fixture
def replacement(until: Any) -> Callable[[Served, set[int]], int]:
    """Waits for a worker that was not there before."""

    def find(served: Served, before: set[int]) -> int:
        until(lambda: workers_of(served) - before)
        (new,) = workers_of(served) - before
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


def counted(url: str) -> float:
    """Return the number of answered planning requests in the metrics of one worker."""
    with urllib.request.urlopen(f"{url}/metrics", timeout=20) as answer:
        lines = answer.read().decode().splitlines()
    labels = '{model="flowmp-small",outcome="ok",transport="http"}'
    return sum(float(line.split()[-1]) for line in lines if f"requests_total{labels}" in line)


def assert_one_worker_is_expected(url: str) -> None:
    with pytest.raises(urllib.error.HTTPError) as caught:
        urllib.request.urlopen(urllib.request.Request(url, data=b"{}"), timeout=20)
    with caught.value as answer:
        error = RequestError.from_dict(json.load(answer))
    assert isinstance(error, InvalidRequest)
    assert "expected a service of one worker: this one has several" in error.message


def test_two_workers_from_their_start_to_the_loss_of_their_supervisor(
    start: Callable[..., Served],
    replacement: Callable[[Served, set[int]], int],
    until: Any,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    """They count together, keep their models, and those that are lost are replaced unnoticed."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    served = start("--drain-s", "3e6")
    known = workers_of(served)
    assert served.line.startswith("flowmp-small ")
    assert served.line.endswith("), 2 workers")
    first, second = sorted(known)
    for action in ("load", "unload"):
        assert_one_worker_is_expected(f"{served.url}/v2/repository/models/flowmp-small/{action}")
    for _ in range(12):  # a connection each, so that both workers are asked
        with AnchorClient(served.url) as client:
            client.plan_request(REQUEST)
    assert [counted(served.url) for _ in range(8)] == [12.0] * 8

    os.kill(first, signal.SIGTERM)  # a new bundle is rolled out like this
    third = replacement(served, known)
    assert counted(served.url) == 12.0

    shutil.rmtree(next(tmp_path.glob("anchorflow-metrics-*")))  # it is made anew
    crowd = Crowd(served.url)
    until(crowd.has_more(10))
    os.kill(second, signal.SIGKILL)
    fourth = replacement(served, {first, second, third})
    os.kill(third, signal.SIGKILL)  # from now on only a worker that came later can answer
    fifth = replacement(served, {first, second, third, fourth})
    until(crowd.has_more(20))
    crowd.stop()
    assert crowd.failures == []
    assert workers_of(served) == {fourth, fifth}
    assert 20 <= counted(served.url) <= crowd.answers

    served.process.kill()
    until(lambda: all(map(is_gone, (fourth, fifth))))


def test_a_signal_to_every_process_is_one_signal(start: Callable[..., Served], until: Any) -> None:
    """As systemd sends it: the supervisor's own signal to its workers does not end the notice."""
    served = start("--notice-s", "2")
    workers = workers_of(served)
    with AnchorClient(served.url) as client:
        for pid in (*workers, served.process.pid):
            os.kill(pid, signal.SIGTERM)
        until(lambda: not client.ready())

        # A worker whose notice had ended would be gone by then.
        with pytest.raises(subprocess.TimeoutExpired):
            served.process.wait(1.0)
        assert workers_of(served) == workers
        assert client.plan_request(REQUEST).model.name == "flowmp-small"
    assert served.ended() == (0, [])
    assert all(map(is_gone, workers))
    assert not AnchorClient(served.url).live()


def test_a_worker_that_cannot_be_replaced_is_tried_again_while_another_serves(
    start: Callable[..., Served], tmp_path: Path
) -> None:
    bundle = Path(shutil.copytree(DEFAULT_BUNDLE, tmp_path / "bundle"))
    served = start("--bundle", str(bundle))
    before = workers_of(served)
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
    assert served.ended(signal.SIGINT)[0] == 0


def test_workers_that_cannot_start_end_the_command(
    start: Callable[..., Served], tmp_path: Path
) -> None:
    served = start("--bundle", str(tmp_path))

    code, lines = served.ended()
    assert (code, served.line) == (1, "")
    assert f"a worker cannot start: {tmp_path}/manifest.json: cannot be read" in lines[0]
    assert lines[-1] == "anchorflow serve: a worker cannot start"


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
    said = failure("serve", "--port", "0", "--workers", "2", "--zenoh", "peer")
    assert said.startswith("anchorflow serve: --workers: expected 1 with --zenoh")
