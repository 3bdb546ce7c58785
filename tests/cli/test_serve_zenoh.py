"""`anchorflow serve --zenoh…`: both transports from one process, and one line where it cannot."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from anchorflow_cli.main import main
from anchorflow_cli.zenoh_options import OPTIONS
from anchorflow_client import AnchorClient, OipCodec
from anchorflow_client.contract.batch import ARRAY_DTYPES
from anchorflow_client.zenoh_client import ZenohAnchorClient, ZenohSettings

PROGRAM = "from anchorflow_cli.main import main; main()"
FEW_STEPS = {"method": "euler", "schedule": {"uniform": 1}}


@pytest.fixture
def endpoint() -> str:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return f"tcp/127.0.0.1:{listener.getsockname()[1]}"


@pytest.fixture
def start() -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Starts `anchorflow serve` of the default bundle with some options."""
    processes: list[subprocess.Popen[str]] = []

    def run(*options: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-u", "-c", PROGRAM, "serve", "--port", "0", *options]
        pipe = subprocess.PIPE
        processes.append(subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True))
        return processes[-1]

    yield run
    for process in processes:
        with process:
            process.kill()


def line_of(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline().rstrip("\n")


def test_one_process_answers_over_both(
    start: Callable[..., subprocess.Popen[str]], endpoint: str
) -> None:
    server = start("--zenoh", "peer", "--zenoh-listen", endpoint, "--zenoh-replica", "r1")
    url = line_of(server).partition(" at ")[2].partition(" ")[0]
    assert line_of(server) == f"zenoh replica r1 (peer, listen {endpoint})"
    asked = {
        "cost_map": np.zeros((64, 64)),
        "resolution": 0.16,
        "x_curr": [-3, 0, 0, 0, 0, 0],
        "x_goal": [3, 0, 0, 0],
        "num_samples": 4,
        "seed": 1,
        "sampler": FEW_STEPS,
    }

    with AnchorClient(url, codec=OipCodec()) as http, ZenohAnchorClient(endpoint) as zenoh:
        assert http.models() == zenoh.models()
        one, other = http.plan(**asked), zenoh.plan(**asked)
    for name in ARRAY_DTYPES:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))

    server.send_signal(signal.SIGINT)
    output, errors = server.communicate(timeout=30)
    assert (server.returncode, output, errors) == (0, "", "")


def failure(*options: str) -> str:
    with pytest.raises(SystemExit) as caught:
        main(["serve", "--port", "0", *options])
    message = str(caught.value.code)
    assert message.startswith("anchorflow serve: ")
    assert "\n" not in message
    return message


def test_what_cannot_be_joined_is_one_line(endpoint: str, tmp_path: Path) -> None:
    broken = tmp_path / "broken.json5"
    broken.write_text("{")

    assert "--zenoh-connect: expected --zenoh or --zenoh-config" in failure(
        "--zenoh-connect", endpoint
    )
    assert "mode: expected peer, client, router, got 'x'" in failure("--zenoh", "x")
    assert "broken.json5: " in failure("--zenoh-config", str(broken))
    assert "config_file: none.json5 is not a file" in failure("--zenoh-config", "none.json5")
    assert "--zenoh-password-file: none: No such file" in failure(
        "--zenoh", "client", "--zenoh-user", "a", "--zenoh-password-file", "none"
    )
    (tmp_path / "password").write_bytes(b"\xff\xfe")
    assert "password: expected text, 'utf-8' codec can't decode" in failure(
        "--zenoh", "peer", "--zenoh-user", "a", "--zenoh-password-file", str(tmp_path / "password")
    )
    assert "--zenoh: expected peer|client|router, got ''" in failure("--zenoh", "")
    assert "--zenoh-replica: expected a name, got ''" in failure(
        "--zenoh", "peer", "--zenoh-replica", ""
    )


def test_a_router_that_is_not_there_is_one_line(
    endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("anchorflow_cli.serving.ZENOH_WAIT_S", 0.3)

    message = failure("--zenoh", "client", "--zenoh-connect", endpoint)

    assert f"nobody listens at {endpoint}" in message


def test_every_setting_has_an_option() -> None:
    """The options have the order of the settings, so that a new setting is not forgotten."""
    settings = list(ZenohSettings.__dataclass_fields__)

    assert [name for name in OPTIONS if name != "replica"] == settings
