"""`anchorflow serve`: the real server in a process of its own, and one line if it cannot start."""

from __future__ import annotations

import json
import signal
import socket
import ssl
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import onnxruntime as ort
import pytest
import trustme
from command_line import Served, failure

from anchorflow_cli import listening
from anchorflow_cli.listening import (
    OTHER_FILES,
    AddressError,
    OpenFilesError,
    listen,
    url_of,
    within_open_files,
)
from anchorflow_cli.serving import eight_bits_on_a_device
from anchorflow_client.http import AnchorClient
from anchorflow_service.bundle import DEFAULT_BUNDLE, load_bundle
from anchorflow_service.bundle.providers import PROVIDERS
from anchorflow_service.http.connections import RESERVE, ConnectionLimits
from anchorflow_service.http.lifecycle import BACKLOG
from anchorflow_service.http.tokens import token_line

# The real command with a card instead of a bundle, which cannot plan.
PROGRAM = """
import sys
from types import SimpleNamespace
from anchorflow_cli import main, serving

card = SimpleNamespace(name="named", version="1.2.3", sha256="ab" * 32)
serving.load_bundle = lambda path: path
serving.Engine = lambda bundle, **_: SimpleNamespace(card=card)
main.main([*sys.argv[1:], "--bundle", "some/bundle"])
"""
INTERRUPTED = f"""
import os, signal, typer

def echo_and_interrupt(line):
    print(line)
    os.kill(os.getpid(), signal.SIGINT)

typer.echo = echo_and_interrupt
{PROGRAM}"""


@pytest.fixture
def start(serve: Callable[..., Served]) -> Callable[..., Served]:
    return partial(serve, program=PROGRAM)


def status(url: str, *, context: ssl.SSLContext, token: str | None = None) -> int:
    headers = {"Authorization": f"Bearer {token}"} if token else {}
    request = urllib.request.Request(url, headers=headers)
    try:
        with urllib.request.urlopen(request, timeout=20, context=context) as answer:
            return answer.status
    except urllib.error.HTTPError as error:
        with error:
            return error.code


def test_tls_tokens_and_a_log_for_machines(start: Callable[..., Served], tmp_path: Path) -> None:
    authority = trustme.CA()
    signed = authority.issue_cert("127.0.0.1")
    file, *paths = (tmp_path / name for name in ("tokens", "ca.pem", "cert.pem", "key.pem"))
    authority.cert_pem.write_to_path(paths[0])
    signed.cert_chain_pems[0].write_to_path(paths[1])
    signed.private_key_pem.write_to_path(paths[2])
    context = ssl.create_default_context(cafile=str(paths[0]))
    file.write_text(token_line("robot-7", ("infer",), "secret"))
    options = ("--tokens", str(file), "--log-format", "json", "--log-level", "info")
    tls = ("--tls-cert", str(paths[1]), "--tls-key", str(paths[2]))
    served = start(*options, *tls, "--drain-s", "1")
    url = served.url

    assert url.startswith("https://127.0.0.1:")
    assert status(f"{url}/v2/health/ready", context=context) == 200
    assert status(f"{url}/v2", context=context) == 401
    assert status(f"{url}/v2", token="secret", context=context) == 200

    code, lines = served.ended(signal.SIGTERM)
    assert code == -signal.SIGTERM
    records = [json.loads(line) for line in lines]
    exchanges = [each for each in records if each["logger"] == "anchorflow_service.access"]
    assert [(each["path"], each["status"], each["caller"]) for each in exchanges] == [
        ("/v2/health/ready", 200, None),
        ("/v2", 401, None),
        ("/v2", 200, "robot-7"),
    ]
    assert all(each["request_id"] for each in exchanges)
    assert all("secret" not in line for line in lines)


def test_an_address_for_all_without_tokens_is_warned_of(start: Callable[..., Served]) -> None:
    _, (line,) = start("--host", "0.0.0.0").ended(signal.SIGTERM)
    assert "everybody who reaches this address may ask: there is no --tokens" in line


def test_it_prints_where_it_answers_and_stops_quietly(start: Callable[..., Served]) -> None:
    served = start()

    line = served.line
    assert (line.partition(" at ")[0], line[-20:]) == ("named 1.2.3", "(bundle some/bundle)")
    with AnchorClient(served.url) as client:
        assert client.ready()
    assert served.ended(signal.SIGINT) == (0, [])


def test_a_ctrl_c_right_after_the_first_line_stops_it_quietly(
    serve: Callable[..., Served],
) -> None:
    served = serve(program=INTERRUPTED)

    assert served.line.startswith("named 1.2.3 at http://")
    assert served.ended() == (0, [])


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="has no full device to print to")
def test_it_serves_without_a_standard_output() -> None:
    with (
        Path("/dev/full").open("w") as full,
        subprocess.Popen(
            [sys.executable, "-c", PROGRAM, "serve", "--port", "0"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
        ) as process,
    ):
        assert process.stderr is not None
        line = process.stderr.readline()
        assert "standard output cannot be written: No space left on device" in line
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(1.0)
        process.send_signal(signal.SIGINT)
        assert (process.communicate(timeout=20)[1], process.returncode) == ("", 0)


def refused(*options: object) -> str:
    """Return the line with which the command fails to start."""
    return failure("serve", "--port", "0", *options).removeprefix("anchorflow serve: ")


def test_an_error_at_the_start_is_one_line(tmp_path: Path) -> None:
    nonsense = tmp_path / "nonsense"
    nonsense.write_text("nonsense")
    absent, wrong = str(tmp_path / "absent"), str(nonsense)
    together = "TLS needs --tls-cert and --tls-key, both of them"

    assert refused("--tokens", absent) == f"{absent}: cannot be read: No such file or directory"
    assert refused("--tokens", wrong).startswith(f"{wrong}: line 1: expected NAME SCOPES")
    assert refused("--tls-cert", wrong) == together
    assert refused("--tls-client-ca", wrong) == together
    assert refused("--tls-cert", wrong, "--tls-key", wrong).startswith(f"{wrong} with {wrong}: ")
    assert refused("--bundle", absent).startswith(f"{absent}/manifest.json: cannot be read")
    assert refused("--repository", str(tmp_path)) == (
        "the repository holds no bundle that can be served"
    )
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        expected = f"cannot listen on 127.0.0.1:{port}: Address already in use"
        assert refused("--port", str(port)) == expected


def test_a_provider_that_this_build_lacks_is_one_line() -> None:
    offered = ort.get_available_providers()
    missing = [name for name, full in PROVIDERS.items() if full not in offered]
    if not missing:
        pytest.skip("this build of onnxruntime has every provider")

    assert refused("--provider", missing[0]).startswith(f"provider: {missing[0]} is not in this")


def test_an_address_of_another_machine_is_refused() -> None:
    with pytest.raises(AddressError, match=r"cannot listen on 192\.0\.2\.1:0"):
        listen("192.0.2.1", 0)


def test_an_ipv6_address_has_brackets() -> None:
    if not socket.has_ipv6:
        pytest.skip("this machine has no IPv6")
    with listen("::1", 0) as listener:
        assert url_of(listener).startswith("http://[::1]:")


def test_no_response_waits_for_an_acknowledgement() -> None:
    """A connection inherits the option from its listener."""
    with listen("127.0.0.1", 0) as listener, socket.create_connection(listener.getsockname()):
        accepted, _ = listener.accept()
        with accepted:
            assert accepted.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


BESIDE = RESERVE + BACKLOG + OTHER_FILES


@pytest.mark.skipif(sys.platform == "win32", reason="has no such limits")
@pytest.mark.parametrize(
    ("soft", "hard", "connections", "raised"),
    [
        (BESIDE + 300, BESIDE + 400, 300, BESIDE + 300),
        (100, BESIDE + 400, 300, BESIDE + 300),
        (100, BESIDE + 20, 20, BESIDE + 20),
        (100, -1, 300, BESIDE + 300),
        (BESIDE, BESIDE, None, BESIDE),
    ],
    ids=["enough", "raised", "fewer", "unlimited", "too few"],
)
def test_connections_fit_into_the_limit_on_open_files(
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    soft: int,
    hard: int,
    connections: int | None,
    raised: int,
) -> None:
    limit = [soft, hard]
    system = SimpleNamespace(
        RLIMIT_NOFILE=7,
        RLIM_INFINITY=-1,
        getrlimit=lambda _: tuple(limit),
        setrlimit=lambda _, new: limit.__setitem__(slice(None), new),
    )
    monkeypatch.setattr(listening, "resource", system)

    if connections is None:
        with pytest.raises(OpenFilesError, match=f"ulimit -n.: expected more than {BESIDE}"):
            within_open_files(ConnectionLimits(max_connections=300))
        return
    limits = within_open_files(ConnectionLimits(max_connections=300))
    assert (limits.max_connections, limit[0]) == (connections, raised)
    assert ("--max-connections is 20 in place of 300" in caplog.text) == (connections == 20)


@pytest.mark.parametrize(
    ("name", "provider", "advised"),
    [("default", "cuda", True), ("default", "cpu", False), ("goalflow", "cuda", False)],
)
def test_a_bundle_in_eight_bits_on_a_gpu_is_told_to_be_exported_whole(
    name: str, provider: str, advised: bool
) -> None:
    folder = DEFAULT_BUNDLE.parent / name
    advice = eight_bits_on_a_device(load_bundle(folder), provider)
    assert (advice is not None) == advised
    assert not advised or f"with --float32 --like {folder}" in str(advice)
