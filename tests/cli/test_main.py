"""The `anchorflow` command: finding commands, and one clear line where one cannot run."""

from __future__ import annotations

import importlib.metadata
import subprocess
import sys
from types import SimpleNamespace
from typing import Any

import pytest

from anchorflow_cli import main as cli
from anchorflow_client.errors import AnchorFlowError

WITHOUT = """
import sys
class Absent:
    @staticmethod
    def find_spec(name, *_):
        if name == {module!r}:
            raise ModuleNotFoundError(name, name=name)
sys.meta_path.insert(0, Absent)
from anchorflow_cli.main import main
main({arguments!r})
"""


def run_without(module: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Runs the command in an interpreter in which `module` is not installed."""
    program = WITHOUT.format(module=module, arguments=arguments)
    return subprocess.run(
        [sys.executable, "-c", program], check=False, capture_output=True, text=True
    )


@pytest.mark.parametrize("command", ["serve", "plan"])
def test_a_base_install_names_the_extra_in_one_line(command: str) -> None:
    answer = run_without("typer", command)

    assert answer.returncode == 1
    assert answer.stderr == (
        f"anchorflow {command} needs typer, which is not installed: "
        "pip install 'anchorflow[service]', in a checkout pip install -e '.[service]'\n"
    )


def test_benchmarks_start_without_torch() -> None:
    answer = run_without("torch", "bench", "--help")

    assert answer.returncode == 0, answer.stderr


def test_a_base_install_lists_the_commands() -> None:
    answer = run_without("typer", "--help")

    assert answer.returncode == 0
    assert "  serve " in answer.stdout
    assert "  plan " in answer.stdout


def test_a_missing_module_of_our_own_is_a_defect_not_an_extra() -> None:
    answer = run_without("anchorflow_client.ros_map", "plan")

    assert "Traceback" in answer.stderr
    assert "pip install" not in answer.stderr


def test_no_command_is_help(capsys: pytest.CaptureFixture[str]) -> None:
    cli.main([])
    assert capsys.readouterr().out.startswith("Usage: anchorflow COMMAND")


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    cli.main(["--version"])
    assert capsys.readouterr().out == f"anchorflow {importlib.metadata.version('anchorflow')}\n"


def test_an_unknown_command_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        cli.main(["sreve"])

    assert caught.value.code == 2
    assert "there is no command 'sreve'" in capsys.readouterr().err


def test_an_error_of_ours_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def app(_: list[str], **__: Any) -> None:
        raise AnchorFlowError("the map is upside down")

    monkeypatch.setattr(cli, "import_module", lambda _: SimpleNamespace(app=app))

    with pytest.raises(SystemExit) as caught:
        cli.main(["plan"])
    assert caught.value.code == "anchorflow plan: the map is upside down"
