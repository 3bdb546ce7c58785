"""Every command that the documentation prints is run as printed, or the list says why it is not.

The quick ones are run here, the slow ones by `make walkthrough`.
"""

from __future__ import annotations

import os
import re
import shlex
import sys
from pathlib import Path

import pytest
import typer
from typer.core import TyperGroup

from anchorflow_cli.main import COMMANDS
from anchorflow_docs.commands.printed import ROOT, commands_of, printed, printed_texts
from anchorflow_docs.commands.sessions import (
    BY_CI,
    NOT_RUN,
    QUICK,
    WALKTHROUGH,
    Session,
    reason_not_to_run,
)
from anchorflow_docs.commands.terminal import Terminal, TerminalError

RUN = {name for session in (*QUICK, *WALKTHROUGH) for name in session.commands}
PRINTED = printed()
TEXTS = printed_texts()
LEFT = {each.name: each.place for each in PRINTED if each.name not in {*RUN, *BY_CI}}


def open_terminal(folder: Path) -> Terminal:
    environment = {**os.environ, "RAY_AUTH_MODE": "disabled"}
    try:
        return Terminal(folder, programs=Path(sys.prefix, "bin"), env=environment)
    except OSError as error:
        pytest.skip(f"no loopback of one's own here: {error}")


def test_every_printed_command_is_run_or_has_a_reason_why_not() -> None:
    assert {name: at for name, at in LEFT.items() if reason_not_to_run(name) is None} == {}
    assert [form for form in NOT_RUN if not any(re.match(form, name) for name in LEFT)] == []
    assert [name for name in (*RUN, *BY_CI) if name not in TEXTS] == []
    assert not {*RUN} & {*BY_CI}


def test_continuous_integration_types_its_own() -> None:
    lines = (ROOT / ".ci" / "run").read_text().splitlines()

    assert {*BY_CI} <= set(lines)


OPTIONS = [name for name in LEFT if name.startswith("anchorflow ") and "--help" not in name]


@pytest.mark.parametrize("name", OPTIONS)
def test_what_takes_too_long_has_options_that_there_are(name: str) -> None:
    _, first, *rest = shlex.split(name)
    command = typer.main.get_command(COMMANDS[first].app())
    while isinstance(command, TyperGroup):
        command = command.get_command(typer.Context(command), rest.pop(0))
        assert command is not None

    command.make_context(first, rest)


@pytest.mark.parametrize("session", QUICK, ids=lambda session: session.name)
def test_a_session_goes_as_printed(session: Session, tmp_path: Path) -> None:
    if session.needs is not None:
        pytest.importorskip(session.needs, reason=f"{session.needs} is not installed")
    for name in ("service", "examples"):
        (tmp_path / name).symlink_to(ROOT / name)
    (tmp_path / ".venv").symlink_to(sys.prefix)
    for make in session.given:
        make(tmp_path)

    with open_terminal(tmp_path) as terminal:
        for text in (*session.before, *(TEXTS[name] for name in session.commands)):
            terminal.type(text)


@pytest.fixture
def terminal(tmp_path: Path) -> Terminal:
    return open_terminal(tmp_path)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("false | true", "ended with 1"),
        ("""echo '{"error": {}}'""", "ended with 0"),
        ("anchorflow serve --bundle nowhere", "nowhere/manifest.json: cannot be read"),
        ("sleep 60 >/dev/null 2>&1 & :", "still running at the end"),
    ],
)
def test_a_command_that_fails_is_seen(
    terminal: Terminal, text: str, says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("anchorflow_docs.commands.terminal.GRACE_S", 0.2)
    with pytest.raises(TerminalError, match=says), terminal:
        terminal.type(text)


def test_a_page_is_read_as_a_shell_reads_it(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "Say `make all`, `make OUT`, `anchorflow plan` or `--out`.\n\n"
        "```sh\none  # why\ntwo \\\n    --three\n\ncat <<'PY' | four\nfive\nPY\n```\n"
        "```python\nsix\n```\n"
    )

    assert [(each.name, each.place) for each in commands_of(page)] == [
        ("one", "page.md, line 4"),
        ("two --three", "page.md, line 5"),
        ("cat <<'PY' | four", "page.md, line 8"),
        ("make all", "page.md, line 1"),
    ]
    module = tmp_path / "module.py"
    module.write_text('"""Does.\n\n    python -m module\n\nor `curl it`.\n"""\n')
    assert [each.name for each in commands_of(module)] == ["python -m module", "curl it"]
