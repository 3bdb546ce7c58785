"""`anchorflow token`: what it prints opens what it writes."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest
from command_line import failure, succeed

from anchorflow_service.http.tokens import TokenFile, token_line


def test_what_is_printed_opens_what_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "tokens"
    succeed("token", file, "robot-7")
    succeed("token", file, "chief", "--scopes", "infer,admin")
    robot, chief = capsys.readouterr().out.split()

    tokens = TokenFile(file)
    found = {name: tokens.find(token) for name, token in (("robot", robot), ("chief", chief))}
    assert found["robot"] is not None
    assert found["chief"] is not None
    assert (found["robot"].name, found["robot"].scopes) == ("robot-7", {"infer"})
    assert (found["chief"].name, found["chief"].scopes) == ("chief", {"infer", "admin"})
    assert robot not in file.read_text()
    assert len(robot) >= 40
    assert stat.S_IMODE(file.stat().st_mode) == 0o600


@pytest.mark.parametrize(
    "text",
    ["", "# NAME SCOPES sha256:DIGEST\n", token_line("robot-7", ("infer",), "first")],
    ids=["empty", "comment", "a last line without an end"],
)
def test_a_token_gets_a_line_of_its_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str
) -> None:
    file = tmp_path / "tokens"
    file.write_text(text)
    succeed("token", file, "robot-8")

    found = TokenFile(file).find(capsys.readouterr().out.strip())
    assert found is not None
    assert found.name == "robot-8"
    assert file.read_text().startswith(text)
    assert len(file.read_text().splitlines()) == len(text.splitlines()) + 1


def test_what_cannot_be_is_one_line_and_changes_nothing(tmp_path: Path) -> None:
    file = tmp_path / "tokens"
    succeed("token", file, "robot-7")
    before = file.read_text()

    assert failure("token", str(file), "robot-7").endswith(
        "tokens: has a token named robot-7 already"
    )
    assert "expected scopes among infer,admin" in failure(
        "token", str(file), "a", "--scopes", "root"
    )
    assert "expected a name" in failure("token", str(file), "a/b")
    assert "NAME SCOPES sha256:DIGEST" in failure("token", str(file), "a b")
    assert file.read_text() == before
    assert "cannot be written" in failure("token", str(tmp_path / "no" / "folder"), "a")

    file.write_text("nonsense\n")
    assert "line 1: expected NAME SCOPES" in failure("token", str(file), "a")
