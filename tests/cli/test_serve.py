"""`anchorflow serve`: the real server in a process of its own, and one line where it cannot run."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from anchorflow_cli.listening import AddressError, listen, url_of
from anchorflow_cli.main import main
from anchorflow_client.http import AnchorClient

# The command as it is, but for a card in place of a bundle: nothing plans here.
PROGRAM = """
from types import SimpleNamespace
from anchorflow_cli import main, serving

card = SimpleNamespace(name="named", version="1.2.3")
serving.load_bundle = lambda path: path
serving.Engine = lambda bundle, **_: SimpleNamespace(card=card)
main.main(["serve", "--port", "0", "--bundle", "some/bundle"])
"""


@pytest.fixture
def server() -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        [sys.executable, "-u", "-c", PROGRAM],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    with process:
        yield process
        process.kill()


def first_line(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline().rstrip("\n")


def test_it_says_where_it_answers_and_stops_quietly(server: subprocess.Popen[str]) -> None:
    line = first_line(server)
    model, _, rest = line.partition(" at ")
    url, _, bundle = rest.partition(" ")

    assert (model, bundle) == ("named 1.2.3", "(bundle some/bundle)")
    with AnchorClient(url) as client:
        assert client.ready()

    server.send_signal(signal.SIGINT)
    output, errors = server.communicate(timeout=20)
    assert (server.returncode, output, errors) == (0, "", "")


IMPATIENT = f"""
import os, signal, typer

def echo_and_interrupt(line):
    print(line)
    os.kill(os.getpid(), signal.SIGINT)

typer.echo = echo_and_interrupt
{PROGRAM}"""


def test_a_ctrl_c_on_its_first_word_stops_it_quietly() -> None:
    run = subprocess.run(
        [sys.executable, "-c", IMPATIENT], capture_output=True, text=True, timeout=60, check=False
    )

    assert (run.returncode, run.stderr) == (0, "")
    assert run.stdout.startswith("named 1.2.3 at http://")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="has no full device to print to")
def test_output_that_goes_nowhere_ends_nothing() -> None:
    with (
        Path("/dev/full").open("w") as full,
        subprocess.Popen(
            [sys.executable, "-c", PROGRAM], stdout=full, stderr=subprocess.PIPE, text=True
        ) as process,
    ):
        assert process.stderr is not None
        line = process.stderr.readline()
        assert "standard output cannot be written: No space left on device" in line
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(1.0)
        process.send_signal(signal.SIGINT)
        assert (process.communicate(timeout=20)[1], process.returncode) == ("", 0)


def test_a_port_in_use_is_one_line() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(SystemExit) as caught:
            main(["serve", "--port", str(port)])

    assert caught.value.code == (
        f"anchorflow serve: cannot listen on 127.0.0.1:{port}: Address already in use"
    )


def test_a_bundle_that_is_none_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["serve", "--port", "0", "--bundle", str(tmp_path)])

    message = str(caught.value.code)
    assert message.startswith(f"anchorflow serve: {tmp_path / 'manifest.json'}: ")
    assert "\n" not in message


def test_an_address_of_another_machine_is_refused() -> None:
    with pytest.raises(AddressError, match=r"cannot listen on 192\.0\.2\.1:0"):
        listen("192.0.2.1", 0)


def test_an_ipv6_address_has_brackets() -> None:
    if not socket.has_ipv6:
        pytest.skip("this machine has no IPv6")
    with listen("::1", 0) as listener:
        assert url_of(listener).startswith("http://[::1]:")


def test_a_repository_of_nothing_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["serve", "--port", "0", "--repository", str(tmp_path)])

    assert caught.value.code == (
        "anchorflow serve: the repository holds no bundle that can be served"
    )


def test_no_answer_waits_for_an_acknowledgement() -> None:
    """A connection inherits the option from its listener."""
    with listen("127.0.0.1", 0) as listener, socket.create_connection(listener.getsockname()):
        accepted, _ = listener.accept()
        with accepted:
            assert accepted.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
