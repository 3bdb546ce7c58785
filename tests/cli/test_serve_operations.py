"""`anchorflow serve` as it is run for others: tokens, TLS, logs; one line where it cannot start."""

from __future__ import annotations

import json
import signal
import ssl
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path

import onnxruntime as ort
import pytest
import trustme

from anchorflow_cli.main import main
from anchorflow_service.bundle.providers import PROVIDERS
from anchorflow_service.http.tokens import token_line

# The command as it is, but for a card in place of a bundle: nothing plans here.
PROGRAM = """
import sys
from types import SimpleNamespace
from anchorflow_cli import main, serving

card = SimpleNamespace(name="named", version="1.2.3", sha256="ab" * 32)
serving.load_bundle = lambda path: path
serving.Engine = lambda bundle, **_: SimpleNamespace(card=card)
main.main(["serve", "--port", "0", "--bundle", "some/bundle", *sys.argv[1:]])
"""

Start = Callable[..., tuple["subprocess.Popen[str]", str]]


@pytest.fixture
def start() -> Iterator[Start]:
    """Starts the command with options; gives the process and its URL."""
    started: list[subprocess.Popen[str]] = []

    def run(*options: str) -> tuple[subprocess.Popen[str], str]:
        process = subprocess.Popen(
            [sys.executable, "-u", "-c", PROGRAM, *options],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        started.append(process)
        assert process.stdout is not None
        return process, process.stdout.readline().partition(" at ")[2].partition(" ")[0]

    yield run
    for process in started:
        process.kill()
        process.communicate(timeout=20)


def ended(process: subprocess.Popen[str]) -> tuple[int, list[str]]:
    """The status after SIGTERM, and the lines on stderr."""
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=60)
    return process.returncode, errors.splitlines()


def status(url: str, *, token: str | None = None, context: ssl.SSLContext | None = None) -> int:
    headers = {"Authorization": f"Bearer {token}"} if token else {}
    request = urllib.request.Request(url, headers=headers)
    try:
        with urllib.request.urlopen(request, timeout=20, context=context) as answer:
            return answer.status
    except urllib.error.HTTPError as error:
        with error:
            return error.code


def test_tokens_and_a_log_for_machines(start: Start, tmp_path: Path) -> None:
    file = tmp_path / "tokens"
    file.write_text(token_line("robot-7", ("infer",), "secret"))
    options = ("--tokens", str(file), "--log-format", "json", "--log-level", "info")
    process, url = start(*options, "--drain-s", "1")

    assert status(f"{url}/v2/health/ready") == 200
    assert status(f"{url}/v2") == 401
    assert status(f"{url}/v2", token="secret") == 200

    code, lines = ended(process)
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


def test_tls(start: Start, tmp_path: Path) -> None:
    authority = trustme.CA()
    signed = authority.issue_cert("127.0.0.1")
    paths = {name: tmp_path / f"{name}.pem" for name in ("ca", "cert", "key")}
    authority.cert_pem.write_to_path(paths["ca"])
    signed.cert_chain_pems[0].write_to_path(paths["cert"])
    signed.private_key_pem.write_to_path(paths["key"])

    _, url = start("--tls-cert", str(paths["cert"]), "--tls-key", str(paths["key"]))

    assert url.startswith("https://127.0.0.1:")
    context = ssl.create_default_context(cafile=str(paths["ca"]))
    assert status(f"{url}/v2/health/live", context=context) == 200


def test_an_address_for_all_without_tokens_is_warned_of(start: Start) -> None:
    process, _ = start("--host", "0.0.0.0")

    _, lines = ended(process)
    assert len(lines) == 1
    assert "everybody who reaches this address may ask: there is no --tokens" in lines[0]


def lacking() -> str:
    """A provider that this build of onnxruntime does not have."""
    offered = ort.get_available_providers()
    missing = [name for name, full in PROVIDERS.items() if full not in offered]
    if not missing:
        pytest.skip("this build of onnxruntime has every provider")
    return missing[0]


def failure(*options: str) -> str:
    with pytest.raises(SystemExit) as caught:
        main(["serve", "--port", "0", *options])
    message = str(caught.value.code)
    assert message.startswith("anchorflow serve: ")
    assert "\n" not in message
    return message.removeprefix("anchorflow serve: ")


def test_what_is_wrong_at_the_start_is_one_line(tmp_path: Path) -> None:
    nonsense = tmp_path / "nonsense"
    nonsense.write_text("nonsense")
    absent, wrong = str(tmp_path / "absent"), str(nonsense)
    together = "TLS needs --tls-cert and --tls-key, both of them"

    assert failure("--tokens", absent) == f"{absent}: cannot be read: No such file or directory"
    assert failure("--tokens", wrong).startswith(f"{wrong}: line 1: expected NAME SCOPES")
    assert failure("--tls-cert", wrong) == together
    assert failure("--tls-client-ca", wrong) == together
    assert failure("--tls-cert", wrong, "--tls-key", wrong).startswith(f"{wrong} with {wrong}: ")
    assert failure("--bundle", absent).startswith(f"{absent}/manifest.json: cannot be read")


@pytest.mark.parametrize("option", ["--notice-s", "--drain-s", "--batch-wait-ms"])
def test_a_time_without_an_end_is_refused(option: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["serve", "--port", "0", "--bundle", "absent", option, "inf"])
    assert f"'{option}': expected a finite number, got inf" in capsys.readouterr().err


def test_a_provider_that_is_not_there_is_one_line() -> None:
    name = lacking()

    assert failure("--provider", name).startswith(f"provider: {name} is not in this build")
